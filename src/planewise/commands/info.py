"""The command info: versions, threads, the cache and the presets."""

from __future__ import annotations

import platform

from planewise import cameras, sensors
from planewise._version import __version__
from planewise.camera import PinholeCamera
from planewise.commands import terminal
from planewise.commands.command_line import reported
from planewise.errors import SetupError
from planewise.spherical import SphericalCamera


def info() -> None:
    """Print versions, threads, where compiled code is kept, and the presets."""
    with reported():
        import numba
        import numpy as np

        from planewise.runtime import threads

        terminal.say(f"planewise {__version__}")
        terminal.say(
            f"Python {platform.python_version()}, NumPy {np.__version__}, Numba {numba.__version__}"
        )
        terminal.say(f"threads: {threads.available()}")
        terminal.say(f"cache: {_cache()}")
        terminal.show_table(
            "cameras",
            (
                (
                    name,
                    f"{camera.width} x {camera.height}",
                    *(f"{value:.2f}" for value in (camera.fx, camera.fy, camera.cx, camera.cy)),
                )
                for name, camera in cameras.PRESETS.items()
                if isinstance(camera, PinholeCamera)
            ),
            ("--camera", "pixels", "fx", "fy", "cx", "cy"),
        )
        terminal.show_table(
            "LiDAR",
            (
                (
                    name,
                    f"{camera.shape[1]} x {camera.shape[0]}",
                    f"{max(camera.elevation):g} ... {min(camera.elevation):g}",
                )
                for name, camera in cameras.PRESETS.items()
                if isinstance(camera, SphericalCamera)
            ),
            ("--camera", "pixels", "elevation in degrees"),
        )
        terminal.show_table(
            "sensors",
            (
                (
                    name,
                    f"{sensor.min_depth:g} - {sensor.max_depth:g} m",
                    f"{1000 * sensor.resolution:g} mm",
                    str(sensor.noise),
                )
                for name, sensor in sensors.PRESETS.items()
            ),
            ("--sensor", "range", "resolution", "noise"),
        )


def _cache() -> str:
    """Where compiled code is kept, and whether it is there."""
    try:
        from planewise import compilation
    except SetupError as error:
        return f"none ({error})"
    state = "compiled" if compilation.is_cached("spatial") else "not compiled yet"
    return f"{compilation.cache_directory()} ({state})"
