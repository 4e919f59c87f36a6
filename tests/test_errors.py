"""What is said of an error."""

import errno
import os

import numpy as np
import pytest

import planewise as pw
from planewise.errors import MissingExtraError, PlanewiseError, naming, needs


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (PlanewiseError("is empty"), "depth: a.png is empty"),
        (OSError(errno.EMFILE, os.strerror(errno.EMFILE)), "a.png cannot be read (Too many open"),
        (OSError(errno.EINVAL, os.strerror(errno.EINVAL)), "a.png cannot be read; it is damaged"),
        (OSError("image file is truncated"), "a.png cannot be read; it is damaged"),
        (KeyError("x"), "a.png cannot be read; it is damaged"),
    ],
)
def test_what_cannot_be_read_is_named(error, message):
    with pytest.raises(PlanewiseError) as raised, naming("depth: a.png"):
        raise error
    assert message in str(raised.value)


@pytest.mark.parametrize("error", [MemoryError(), MissingExtraError("pillow", "drawing")])
def test_what_is_no_fault_of_a_file_is_not_blamed_on_it(error):
    with pytest.raises(type(error)) as raised, naming("depth: a.png"):
        raise error
    assert raised.value is error


def test_a_package_that_is_missing_is_named_with_its_extra():
    message = r"drawing needs the package none, .*planewise\[viz\]"
    with pytest.raises(MissingExtraError, match=message), needs("none", "drawing", "viz"):
        import planewise_needs_this  # noqa: F401


SPINNING = pw.SphericalCamera.spinning([10, 0, -10], columns=8)
PINHOLE = pw.PinholeCamera(fx=50, fy=50, cx=4, cy=4)
LARGE, COMPLEX = 10**400, np.full((3, 3), 1 + 1j)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("start", lambda: pw.SphericalCamera.spinning([10, 0, -10], 8, start=None)),
        ("start", lambda: pw.SphericalCamera.spinning([10, 0, -10], 8, start="x")),
        *(
            ("pixels", lambda camera=camera, pixels=pixels: camera.unproject(pixels))
            for camera in (SPINNING, PINHOLE)
            for pixels in (3.0, [], [1, 2, 3], np.zeros((2, 4)), "x", None, COMPLEX, [LARGE, 1])
        ),
        ("offset", lambda: pw.PointCloud(points=np.zeros((4, 3)), offset=COMPLEX[0])),
        ("offset", lambda: pw.PointCloud(points=np.zeros((4, 3)), offset=[LARGE, 0, 0])),
        ("offset", lambda: pw.PointCloud(points=np.zeros((4, 3)), offset=np.eye(3))),
        ("origins", lambda: pw.PointCloud(points=np.zeros((4, 3)), origins=COMPLEX)),
        ("origins", lambda: pw.PointCloud(points=np.zeros((4, 3)), origins=[[LARGE, 0, 0]])),
        ("shape", lambda: SPINNING.check(np.array(3))),
        ("shape", lambda: SPINNING.check(np.eye(2, dtype=int))),
        ("fx", lambda: pw.PinholeCamera(fx=np.eye(3), fy=50, cx=4, cy=4)),
        ("cx", lambda: pw.PinholeCamera(fx=50, fy=50, cx=np.eye(3), cy=4)),
        ("width", lambda: pw.PinholeCamera(fx=50, fy=50, cx=4, cy=4, width=np.eye(3), height=3)),
    ],
)
def test_what_an_argument_cannot_be_is_said_in_one_line(name, call):
    with pytest.raises(ValueError, match=name) as raised:
        call()
    assert "\n" not in str(raised.value)
    assert raised.type is ValueError
