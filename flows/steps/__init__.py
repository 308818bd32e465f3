"""The flow's own steps: what happens between the services, each a process with a manifest like theirs."""

from flows.steps.assembly import ASSEMBLE_INPUTS
from flows.steps.decided import APPLY_DECISIONS
from flows.steps.execution import EXECUTE
from flows.steps.horizon import SET_HORIZON
from flows.steps.import_case import IMPORT_CASE
from flows.steps.observed import OBSERVED_PLACES
from flows.steps.perimeter_score import SCORE_PERIMETER
from flows.steps.planner_rows import ACTIVE_ONLY, PLANNER_ROWS
from flows.steps.priority_map import PRIORITY_MAP
from flows.steps.score import SCORE
from flows.steps.seen_fires import SEEN_FIRES
from flows.steps.situation import SITUATION
from flows.steps.uplink import UPLINK

LOCAL_STEPS = [
    IMPORT_CASE,
    ASSEMBLE_INPUTS,
    APPLY_DECISIONS,
    SET_HORIZON,
    UPLINK,
    EXECUTE,
    OBSERVED_PLACES,
    SITUATION,
    SCORE,
    SCORE_PERIMETER,
    SEEN_FIRES,
    PRIORITY_MAP,
    ACTIVE_ONLY,
    PLANNER_ROWS,
]
