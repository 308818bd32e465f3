"""The data-cycle model through OR-Tools MathOpt (HiGHS): interior-point LP without crossover, and branch and bound.

Work is limited by counted iterations and nodes, so equal inputs give equal results; seconds are only a guard, and a
result they cut says so.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass

import numpy as np
from ortools.math_opt import model_pb2
from ortools.math_opt.python import mathopt

from services.planning.milp import DataCycleModel, lagrangian_bound
from services.planning.problem import BoolArray, FloatArray

LP_ITERATIONS = 500


@dataclass(frozen=True)
class Solution:
    """Values of w (``images``) and d (``links``), a proven upper ``bound``, ``reduced`` cost per image.

    ``feasible`` is false when the solver has no point; ``time_limited`` when the guard, not the work limit, ended it.
    """

    images: FloatArray
    links: FloatArray
    bound: float
    reduced: FloatArray
    feasible: bool
    time_limited: bool
    nodes: int = 0
    dual: FloatArray | None = None
    """Row multipliers of a relaxation."""
    groups: FloatArray | None = None
    """Values of x of a relaxation."""


def to_proto(model: DataCycleModel, whole: BoolArray) -> model_pb2.ModelProto:
    """The model as a MathOpt proto; ``whole`` marks integer columns."""
    proto = model_pb2.ModelProto()
    columns, rows = len(model.cost), len(model.row_low)
    proto.variables.ids.extend(range(columns))
    proto.variables.lower_bounds.extend(model.low.tolist())
    proto.variables.upper_bounds.extend(model.high.tolist())
    proto.variables.integers.extend(whole.tolist())
    proto.objective.maximize = True
    used = np.flatnonzero(model.cost)
    proto.objective.linear_coefficients.ids.extend(used.tolist())
    proto.objective.linear_coefficients.values.extend(model.cost[used].tolist())
    proto.linear_constraints.ids.extend(range(rows))
    proto.linear_constraints.lower_bounds.extend(model.row_low.tolist())
    proto.linear_constraints.upper_bounds.extend(model.row_high.tolist())
    sizes = np.diff(model.matrix.indptr)
    proto.linear_constraint_matrix.row_ids.extend(np.repeat(np.arange(rows), sizes).tolist())
    proto.linear_constraint_matrix.column_ids.extend(model.matrix.indices.tolist())
    proto.linear_constraint_matrix.coefficients.extend(model.matrix.data.tolist())
    return proto


def trivial_bound(model: DataCycleModel) -> float:
    """Everything observed: the bound that needs no proof."""
    return float(np.maximum(model.cost * model.high, model.cost * model.low).sum())


def solve_relaxation(model: DataCycleModel, time_limit_s: float) -> Solution:
    """LP relaxation by interior point without crossover: guidance and a bound in seconds where simplex needs minutes.

    The bound is computed from the duals by weak duality, not taken from the solver's word. Presolve is off because
    HiGHS cannot carry an interior point without a basis back through its postsolve. A point that time cut still counts.
    """
    parameters = mathopt.SolveParameters(time_limit=datetime.timedelta(seconds=max(0.1, time_limit_s)))
    for name, value in {"solver": "ipm", "run_crossover": "off", "presolve": "off", "parallel": "off"}.items():
        parameters.highs.string_options[name] = value
    parameters.highs.int_options["ipm_iteration_limit"] = LP_ITERATIONS
    result = _solve(model, np.zeros(len(model.cost), bool), parameters)
    point = result.solutions[0] if result is not None and result.solutions else None
    if point is None or point.dual_solution is None or point.primal_solution is None:
        return _nothing(model, time_limited=True)
    values = np.array(list(point.primal_solution.variable_values.values()))
    dual = np.array(list(point.dual_solution.dual_values.values()))
    bound, reduced = lagrangian_bound(model, dual)
    cut = result is not None and result.termination.limit == mathopt.Limit.TIME
    return Solution(
        values[: model.images], _links(model, values), min(bound, trivial_bound(model)), reduced[: model.images],
        feasible=True, time_limited=cut, dual=dual, groups=values[model.images : model.images + model.groups],
    )  # fmt: skip


def branch_and_bound(
    model: DataCycleModel, whole: BoolArray, gap: float, node_limit: int, time_limit_s: float, slack: float = 1e-6
) -> Solution:
    """The mixed-integer model by HiGHS to a relative ``gap``, at most ``node_limit`` nodes; rows hold to ``slack``."""
    parameters = mathopt.SolveParameters(
        time_limit=datetime.timedelta(seconds=max(0.1, time_limit_s)), node_limit=node_limit,
        relative_gap_tolerance=gap, absolute_gap_tolerance=1e-9,
    )  # fmt: skip
    parameters.highs.string_options["parallel"] = "off"
    parameters.highs.double_options["mip_feasibility_tolerance"] = slack
    result = _solve(model, whole, parameters)
    if result is None:
        return _nothing(model, time_limited=False)
    cut = result.termination.limit == mathopt.Limit.TIME
    if not result.solutions or result.solutions[0].primal_solution is None:
        return _nothing(model, time_limited=cut)
    primal = result.solutions[0].primal_solution
    values = np.array(list(primal.variable_values.values()))
    proven = float(result.termination.objective_bounds.dual_bound)
    bound = min(trivial_bound(model), proven + 1e-9 * abs(proven)) if np.isfinite(proven) else trivial_bound(model)
    return Solution(
        values[: model.images], _links(model, values), bound, np.zeros(model.images), feasible=True, time_limited=cut,
        nodes=int(result.solve_stats.node_count),
    )  # fmt: skip


def _links(model: DataCycleModel, values: FloatArray) -> FloatArray:
    return values[model.images + model.groups : model.images + model.groups + model.links]


def _nothing(model: DataCycleModel, time_limited: bool) -> Solution:
    return Solution(
        np.zeros(model.images), np.zeros(model.links), trivial_bound(model), np.zeros(model.images), feasible=False,
        time_limited=time_limited,
    )  # fmt: skip


def _solve(model: DataCycleModel, whole: BoolArray, parameters: mathopt.SolveParameters) -> mathopt.SolveResult | None:
    """Run HiGHS; None where it ends in a state that MathOpt cannot express (treated as no solution)."""
    built = mathopt.Model.from_model_proto(to_proto(model, whole))
    try:
        return mathopt.solve(built, mathopt.SolverType.HIGHS, params=parameters)
    except (RuntimeError, AttributeError, ValueError):  # MathOpt 9.15 raises AttributeError while reporting a status
        return None
