"""Distortion of a lens as calibration files write it down."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import shown
from planewise.errors import PlanewiseError
from planewise.files.numbers import first_of, numbers_of
from planewise.lens import COUNTS, ORDER

_PLAIN_MODELS = {
    "",
    "none",
    "plumb_bob",
    "radtan",
    "brown_conrady",
    "pinhole",
    "opencv",
    "perspective",
    "rational_polynomial",
}
_MODELS = ("distortion_model", "distortion_type", "camera_model", "lens_model", "model")
_REALSENSE = (  # by their numbers in librealsense
    "none",
    "modified_brown_conrady",
    "inverse_brown_conrady",
    "ftheta",
    "brown_conrady",
    "kannala_brandt4",
)
_ROWS = (  # names in lower case, without anything between their words
    "d",
    "distortion",
    "distortioncoefficients",
    "distortioncoeffs",
    "distortionparameters",
    "distcoefficients",
    "distcoeffs",
    "distcoefs",
    "dist",
    "coeffs",
)
_RADIAL, _TANGENTIAL = "radialdistortion", "tangentialdistortion"  # as MATLAB has them
_NAMES = ("k1", "k2", "p1", "p2", "k3")
_FURTHER = ("k4", "k5", "k6")
_OTHER_MODELS = {  # by what says that they are there
    "fisheye": "fisheye",
    "isfisheye": "fisheye",
    "fisheyemodel": "fisheye",
    "xi": "omnidirectional",
}


def distortion_of(values: Mapping[str, Any]) -> tuple[float, ...]:
    """Coefficients of named values in the order of `planewise.lens`; empty where all are zero.

    They stand in a row, by their own names, or as radial and tangential ones.

    Parameters
    ----------
    values : mapping
        By names in lower case.

    Raises
    ------
    PlanewiseError
        If the model is another one, or a distortion is stated in a way that is not known.
    """
    if isinstance(values.get("distortion"), str):  # RealSense names the model so
        values = {_MODELS[0]: values["distortion"], **values}
        del values["distortion"]
    numbers = _numbers(values)
    for count in (8, 5):  # what OpenCV writes beyond is zero of most lenses
        if not np.any(numbers[count:]):
            numbers = numbers[:count]
    stated = first_of(values, *_MODELS)
    if stated in range(len(_REALSENSE)):
        stated = _REALSENSE[stated]
    model = str(stated or "").lower()
    model = model.removeprefix("distortion.").replace(" ", "_")
    for name, value in values.items():
        other = _OTHER_MODELS.get(_bare(name))
        if other and (str(value).lower() == "true" or _is_stated(value)):
            model = other
    plain = model in _PLAIN_MODELS
    if "brown_conrady" in model and not np.any(numbers):
        plain = True
    if not plain:
        raise PlanewiseError(
            f"has the distortion model {shown(model)}, which is not supported (plumb_bob and "
            "rational_polynomial are); undistort the depth image, or give its rectified camera"
        )
    if not np.any(numbers):
        return ()
    if numbers.size not in COUNTS:
        raise PlanewiseError(f"has {numbers.size} distortion coefficients; expected {ORDER}")
    return tuple(numbers.tolist())


def _numbers(values: Mapping[str, Any]) -> NDArray[np.float64]:
    """All coefficients that are stated."""
    plain = {_bare(name): value for name, value in values.items()}
    for name, value in values.items():
        other = _bare(name) not in {*_ROWS, _RADIAL, _TANGENTIAL}
        if "distort" in name and other and _is_stated(value):
            raise PlanewiseError(
                f"states a distortion as {shown(name)}, which is not known; expected a row "
                "'distortion' or 'D', or k1, k2, p1, p2 and k3"
            )
    given = first_of(plain, *_ROWS)
    if isinstance(given, Mapping) and "data" not in given:
        return _by_name({str(name).lower(): value for name, value in given.items()})
    if given is not None:
        return numbers_of(given)
    if (radial := plain.get(_RADIAL)) is not None:
        k, p = numbers_of(radial), numbers_of(plain.get(_TANGENTIAL, (0.0, 0.0)))
        if k.size not in (2, 3) or p.size != 2:
            raise PlanewiseError(
                f"has {k.size} radial and {p.size} tangential coefficients; expected 2 or 3, and 2"
            )
        return np.concatenate((k[:2], p, k[2:]))
    return _by_name(plain)


def _bare(name: str) -> str:
    return name.replace("_", "").replace("-", "")


def _is_stated(value: Any) -> bool:
    """Whether a value is or holds a number other than zero."""
    if isinstance(value, Mapping):
        return any(map(_is_stated, value.values()))
    if isinstance(value, (list, tuple, np.ndarray)):
        return any(map(_is_stated, value))
    return isinstance(value, (int, float)) and not isinstance(value, bool) and value != 0


def _by_name(values: Mapping[str, Any]) -> NDArray[np.float64]:
    if values.get("k4") and not all(name in values for name in _FURTHER):
        # A fisheye has k1 to k4.
        raise PlanewiseError("has k4 without k5 and k6: is it a fisheye? These are not supported")
    numbers = [values.get(name) or 0.0 for name in (*_NAMES, *_FURTHER)]
    return np.concatenate([numbers_of(number) for number in numbers])
