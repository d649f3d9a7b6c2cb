"""The shipped detectors and planners keep the contracts of their kind."""

from mavfi.config import PlannerConfig, shipped
from mavfi.testing import DetectorContract, PlannerContract


class TestGaussian(DetectorContract):
    detector = "gaussian"


class TestAutoencoder(DetectorContract):
    detector = "autoencoder"


class TestAcceptance(DetectorContract):
    detector = "acceptance"


class TestRrt(PlannerContract):
    planner = shipped("planners", PlannerConfig, "rrt")


class TestRrtConnect(PlannerContract):
    planner = shipped("planners", PlannerConfig, "rrt_connect")


class TestRrtStar(PlannerContract):
    planner = shipped("planners", PlannerConfig, "rrt_star")
