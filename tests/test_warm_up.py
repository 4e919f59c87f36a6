"""What a second process compiles is what the first one needs."""

import json
import subprocess
import sys

SCRIPT = """
import importlib, json, pkgutil
from numba.core.dispatcher import Dispatcher
import planewise as pw
from planewise import kernels, scenes
from planewise.warm_up import later_stages

def compiled():
    out = {}
    for module in pkgutil.iter_modules(kernels.__path__):
        names = vars(importlib.import_module("planewise.kernels." + module.name))
        for name, loop in names.items():
            if isinstance(loop, Dispatcher) and loop.signatures:
                out[module.name + "." + name] = sorted(map(str, loop.signatures))
    return out

later_stages()
warm = compiled()
scene = scenes.room(0, size=(240, 320))
pw.detect_planes(scene.depth, scene.camera, scene.sensor)
print(json.dumps([warm, compiled()]))
"""

LATER = {"labels", "creases", "units", "groups", "group_data", "masks", "plane_sums"}


def test_the_later_stages_are_compiled_for_the_types_of_a_real_frame():
    run = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    warm, real = json.loads(run.stdout)
    later = {name: types for name, types in real.items() if name.split(".")[0] in LATER}
    assert {name.split(".")[0] for name in later} == LATER
    assert {name: warm.get(name) for name in later} == later
