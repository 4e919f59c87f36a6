"""Shared scenes and data."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks.frames import real
from hypothesis import settings
from PIL import Image

import planewise as pw
from planewise import compilation, scenes
from tests import browser

# How long an example takes is not what it tests, and machines are busy. Where others wait for the
# verdict, examples are the same in every run.
settings.register_profile("untimed", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("untimed")

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session", autouse=True)
def compiled():
    """Compile before any test looks at what a user would see the second time."""
    camera = pw.PinholeCamera(fx=50, fy=52, cx=31.0, cy=24.5)
    for search in ("joint", "sequential"):
        pw.detect_planes(np.full((48, 64), 2.0), camera, pw.Sensor(), search=search)
    compilation.wait_for_help()


_NOBODY = 2**31 - 1  # no process has that number


@pytest.fixture
def started(monkeypatch):
    """Commands of the processes that help, which are not run; nothing has been said before."""
    commands = []
    monkeypatch.setattr(
        compilation.subprocess,
        "Popen",
        lambda *a, **_: commands.append(a[0]) or SimpleNamespace(pid=_NOBODY),
    )
    monkeypatch.setattr(compilation, "_helpers", [])
    monkeypatch.setattr(compilation, "_said", set())
    return commands


def real_file(folder, name):
    """File of a real frame or scan by set and name; skips where the data is absent."""
    path = SHARED / folder / f"{name}.npz"
    if not path.exists():
        pytest.skip(f"real data is not part of the project: {folder}/{name} is not here")
    return path


@pytest.fixture(scope="session")
def real_frames():
    """Reader of a real frame by set and name; skips where the data is absent."""

    def read(folder, name):
        with np.load(real_file(folder, name)) as frame:
            fx, fy, cx, cy = frame["K"]
            camera = pw.PinholeCamera(fx=fx, fy=fy, cx=cx, cy=cy)
            return frame["depth"], camera, float(frame["depth_scale"])

    return read


@pytest.fixture(scope="session")
def every_real_frame():
    """All real frames; skips where the data is absent."""
    frames = list(real())
    if not frames:
        pytest.skip("real data is not part of the project: none is here")
    return frames


@pytest.fixture(scope="session")
def real_points():
    """Reader of the points of a real scan by set and name; skips where the data is absent."""

    def read(folder, name):
        with np.load(real_file(folder, name)) as scan:
            return scan["points"]

    return read


@pytest.fixture
def camera():
    """Camera of a small image, 48 x 64."""
    return pw.PinholeCamera(fx=50, fy=52, cx=31.0, cy=24.5)


@pytest.fixture(scope="module")
def scene():
    """Three faces that stand out of a wall, 120 x 160."""
    return scenes.corner(size=(120, 160))


@pytest.fixture(scope="module")
def model(scene):
    """What is found in it."""
    return pw.detect_planes(scene.depth, scene.camera, scene.sensor)


@pytest.fixture
def depth(tmp_path, scene):
    """Its depth as a file, in a folder of its own."""
    path = tmp_path / "in" / "depth.png"
    path.parent.mkdir()
    Image.fromarray(scene.depth).save(path)
    return path


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """A page of a browser; skips where none is installed."""
    program = browser.find()
    if program is None:
        pytest.skip(f"no browser is installed: none of {', '.join(browser.NAMES)}")
    page = browser.Page(program, tmp_path_factory.mktemp("profile"))
    yield page
    page.close()


def render(planes, camera, shape):
    """Depth of the nearest of some planes (rows of normal and distance), and which it is."""
    rays = camera.rays(shape)
    with np.errstate(divide="ignore"):
        depths = np.array([-p[3] / (rays @ p[:3]) for p in planes])
    depths[depths <= 0] = np.inf
    return depths.min(axis=0), depths.argmin(axis=0) + 1


def quilt(rng, shape, planes, pieces=5):
    """Labels 0 ... planes - 1 of some random convex pieces of an image."""
    seeds = rng.uniform(0, shape, (pieces, 2))
    place = np.indices(shape).reshape(2, 1, -1)
    nearest = np.linalg.norm(place - seeds.T[:, :, None], axis=0).argmin(axis=0)
    return (nearest % planes).reshape(shape)


@pytest.fixture
def roof(camera):
    """Two planes that meet like a roof: depth, true planes, true labels, noise 2 mm."""
    rng = np.random.default_rng(7)
    planes = np.array([[0.5, 0.0, -0.8, 1.4], [-0.5, 0.1, -0.8, 1.4]])
    planes[:, :3] /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    depth, labels = render(planes, camera, (48, 64))
    return depth + rng.normal(0, 0.002, depth.shape), planes, labels
