"""Memory from call to call."""

import platform

import pytest

from tests.command import run_python

# In a process of its own: what came before shapes the heap.
SCRIPT = """
import resource
import planewise as pw

scene = pw.scenes.room(0)

def call():
    pw.detect_planes(scene.depth, scene.camera, scene.sensor, objective="paper", threads=1)

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

call()
call()
before = faults()
for _ in range(3):
    call()
print((faults() - before) // 3)
"""


def faults_per_call(**environment):
    return int(run_python(SCRIPT, **environment).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries keep what they do")
def test_calls_find_the_memory_of_those_before_them():
    assert faults_per_call() < 500  # of 4 KiB; arrays of a call take some 10,000
    # What the environment says is left alone.
    assert faults_per_call(MALLOC_TRIM_THRESHOLD_="131072", MALLOC_MMAP_THRESHOLD_="131072") > 5000
