"""What is wrong with the planner itself, not with its inputs."""

from __future__ import annotations

from shared.errors import SmokeglintError


class PlanningBugError(SmokeglintError):
    """A plan of ours that the independent replay rejects, or that is worth more than its bound: never published."""
