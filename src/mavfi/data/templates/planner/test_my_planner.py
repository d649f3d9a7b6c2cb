"""What the pipeline expects of a planner, as a suite of tests; mavfi's own planners pass it."""

from mavfi.config import PlannerConfig
from mavfi.testing import PlannerContract


class TestMyPlanner(PlannerContract):
    """Among others: equal seeds give equal paths, and `random` is all that it remembers."""

    planner = PlannerConfig(name="my_planner:MyPlanner")
