"""Checks that a plug-in's author runs: one class in a test file, and pytest does the rest.

    from testbed.conformance import LawConformance
    from my_package import Springs

    class TestSprings(LawConformance):
        make = Springs

docs/plugins.md has the same for cameras and thrusters.
"""

from testbed.conformance.law import LawConformance, check_law
from testbed.conformance.pose_source import CamerasBench, PoseSourceConformance, check_pose_source
from testbed.conformance.thrusters import ThrusterBench, ThrustersConformance, check_thrusters

__all__ = [
    "CamerasBench",
    "LawConformance",
    "PoseSourceConformance",
    "ThrusterBench",
    "ThrustersConformance",
    "check_law",
    "check_pose_source",
    "check_thrusters",
]
