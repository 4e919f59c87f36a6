"""What other processes compile is what the first one needs."""

import json
import subprocess
import sys

import pytest

SCRIPT = """
import importlib, json, pkgutil
import numpy as np
from numba.core.dispatcher import Dispatcher
import planewise as pw
from planewise import kernels, scenes
from planewise.{}warm_up import later_stages

def compiled():
    out = dict()
    for module in pkgutil.iter_modules(kernels.__path__):
        names = vars(importlib.import_module("planewise.kernels." + module.name))
        for name, loop in names.items():
            if not isinstance(loop, Dispatcher) or loop.targetoptions.get("no_cpython_wrapper"):
                continue  # part of others, and compiled only where these are not kept
            if loop.signatures:
                out[module.name + "." + name] = sorted(map(str, loop.signatures))
    return out

later_stages()
warm = compiled()
{}
print(json.dumps([warm, compiled()]))
"""

IMAGE = """
scene = scenes.room(0, size=(240, 320))
pw.detect_planes(scene.depth, scene.camera, scene.sensor)
"""
CLOUD = """
points = np.random.default_rng(0).uniform(0, 4, (6000, 3))
points[:3000, 2] = 0
points[3000:, 0] = 0
pw.detect_planes_in_points(points, pw.Sensor(max_depth=10, noise=0.01))
"""
LATER = {
    "labels", "creases", "units", "groups", "group_data", "masks", "plane_sums", "segments",
    "squares", "faces", "folds",
}  # fmt: skip
LATER_OF_CLOUDS = {"cloud_segments", "cloud_labels", "cloud_information"}


def loops_of(module, call):
    """Types that every loop is compiled for after the warm-up, and after a call as well."""
    script = SCRIPT.format(module, call)
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return json.loads(run.stdout)


@pytest.mark.parametrize(
    ("module", "call", "names"), [("", IMAGE, LATER), ("clouds.", CLOUD, LATER_OF_CLOUDS)]
)
def test_the_later_stages_are_compiled_for_the_types_of_a_real_call(module, call, names):
    warm, real = loops_of(module, call)
    later = {name: types for name, types in real.items() if name.split(".")[0] in names}
    assert {name.split(".")[0] for name in later} == names
    assert {name: warm.get(name) for name in later} == later
