"""From a depth file to a folder of results: what the command line does with each frame."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import unit_told
from planewise.camera import Camera
from planewise.commands.command_line import check_kept, unusual_unit
from planewise.errors import NO_ROOM, PlanewiseError, SetupError, naming
from planewise.files.camera import no_camera
from planewise.files.colour import FORMATS, read_colour
from planewise.files.depth import DepthFile, read_depth
from planewise.files.result_names import FILES, OUTLINE_FILES, PARAMETERS, stale_files
from planewise.results.image import write_results
from planewise.runtime import threads
from planewise.sensor import Sensor
from planewise.spherical import SphericalCamera
from planewise.whole_files import output_folder

if TYPE_CHECKING:
    from planewise.model import PlaneModel
    from planewise.options import Options


@dataclass(frozen=True, kw_only=True)
class Done:
    """A frame whose results are written.

    Attributes
    ----------
    model : PlaneModel
        What was found.
    seconds : float
        Time of the detection without files; the first run on a machine compiles in it.
    folder : Path
        Where the files are.
    out_of_range : str
        What is to be said where most readings are outside the sensor's range; empty where they are
        not, or the model's note says it.
    unit : str
        What is to be said of the unit of the readings; empty where it is told or usual.
    """

    model: PlaneModel
    seconds: float
    folder: Path
    out_of_range: str
    unit: str


@dataclass(frozen=True, kw_only=True)
class Failed:
    """A frame that could not be used, and why."""

    path: Path
    reason: str


@dataclass(frozen=True, kw_only=True)
class Job:
    """What all frames have in common; what is ``None`` their files have to say.

    Attributes
    ----------
    sensor : Sensor
        Range, resolution and noise.
    options : Options
        How to search.
    camera : Camera, optional
        Intrinsics.
    depth_scale : float, optional
        Metres per unit of integer depth.
    rgb : Path, optional
        Picture to draw over; for a folder of frames a folder of pictures of the same names.
    outlines : bool
        Write the outlines of the planes, too.
    partition : Path, optional
        Regions, as `read_partition` takes them.
    scan : int, optional
        Which scan of a file of several.
    as_far : bool
        Whether the sensor of a scan sees as far as its points lie, for nobody says how far.
    read : tuple of str or None
        Files that the camera and the sensor are of, or names that are none.
    """

    sensor: Sensor
    options: Options
    camera: Camera | None = None
    depth_scale: float | None = None
    rgb: Path | None = None
    outlines: bool = False
    partition: Path | None = None
    scan: int | None = None
    as_far: bool = False
    read: tuple[str | None, ...] = ()

    def run(self, path: Path, target: Path, *, many: bool = False) -> Done:
        """Detect the planes of one file and write the results to the folder `target`.

        `many` says that it is one of several.

        Raises
        ------
        ValueError
            If the file, the camera or the folder cannot be used; then nothing is written.
        """
        frame = read_depth(path, scan=self.scan)
        camera, sensor = self.camera or frame.camera, self._sensor(frame)
        if camera is None:
            raise no_camera(path.name)
        scale = frame.depth_scale if self.depth_scale is None else self.depth_scale
        unit = "" if unit_told(frame.depth, scale) else unusual_unit(sensor.resolution)
        rgb = self._picture(path, frame)
        options = self._options(path, rgb, many)
        # A folder of masks is read whole: the results would be masks of the next run.
        stale = stale_files(target)
        written = [target, *(target / name for name in (*FILES, *OUTLINE_FILES, *stale))]
        masks = None if self.partition is None else self.partition / path.stem
        check_kept(written, (path, self.rgb, self.partition, masks, *self.read))
        if not many:
            self._load()
        with output_folder(target, stale) as folder:
            model, seconds, beyond = find_planes(frame.depth, camera, sensor, scale, options, rgb)
            with threads.allowed(threads.chosen(self.options.threads)):
                write_results(
                    folder,
                    model,
                    depth=frame.depth,
                    camera=camera,
                    sensor=sensor,
                    depth_scale=scale,
                    rgb=rgb,
                    source=path.name,
                )
            if self.outlines:
                self._write_outlines(folder, model, camera, sensor.max_depth)
        return Done(model=model, seconds=seconds, folder=target, out_of_range=beyond, unit=unit)

    def _load(self) -> None:
        """Load what the options need beyond the core, or say so before anything is compiled."""
        if self.outlines:
            from planewise.outlines.outlines import load_shapely

            load_shapely()
        if self.options.partition is not None:
            from planewise.partition import Graph, SegmentAnything

            if isinstance(self.options.partition, Graph | SegmentAnything):
                self.options.partition.load()

    def _sensor(self, frame: DepthFile) -> Sensor:
        """The sensor of a frame."""
        if not (self.as_far and isinstance(frame.camera, SphericalCamera)):
            return self.sensor
        farthest = float(frame.depth.max(initial=0.0, where=np.isfinite(frame.depth)))
        return replace(self.sensor, max_depth=farthest)

    def _write_outlines(
        self, folder: Path, model: PlaneModel, camera: Camera, max_depth: float
    ) -> None:
        from planewise.outlines.image import outline_image
        from planewise.results.outlines import write_outlines

        surfaces = outline_image(
            model, camera, instances=self.options.instances, max_depth=max_depth
        )
        write_outlines(folder, surfaces, frame=f"{camera.frame}, from the camera")

    def run_folder(self, paths: list[Path], target: Path) -> Iterator[Done | Failed]:
        """Do every file of a list, each into its own folder below `target`.

        A frame that cannot be used is reported, and the others go on.

        Raises
        ------
        PlanewiseError
            If none can be done, such as without a package that the options need.
        OSError
            If the disk is full.
        """
        if self.rgb is not None and not self.rgb.is_dir():
            raise PlanewiseError(
                f"rgb: {self.rgb} is one picture; a folder of depth images takes a folder of them"
            )
        self._load()
        for path, name in zip(paths, _folder_names(paths), strict=True):
            try:
                yield self.run(path, target / name, many=True)
            except SetupError:
                raise
            except (ValueError, OSError) as error:
                if isinstance(error, OSError) and error.errno in NO_ROOM:
                    raise  # no other frame would have any
                named = path.name in str(error)
                kept = ""
                if (target / name / PARAMETERS).is_file():
                    kept = f"; {target / name} still has what an earlier run found"
                yield Failed(path=path, reason=f"{'' if named else f'{path.name}: '}{error}{kept}")

    def _options(self, path: Path, rgb: NDArray[np.uint8] | None, many: bool) -> Options:
        """Options for one frame, whose regions may be in a file of their own."""
        from planewise.partition import SegmentAnything

        if isinstance(self.options.partition, SegmentAnything) and rgb is None:
            raise PlanewiseError("partition: sam needs a picture of the view; give --rgb")
        if self.partition is None:
            return self.options
        from planewise.results.partition import read_partition

        regions = read_partition(self.partition, path.stem, many=many)
        return replace(self.options, partition=regions)

    def _picture(self, path: Path, frame: DepthFile) -> NDArray[np.uint8] | None:
        if self.rgb is None:
            return frame.rgb
        from planewise.drawing.overlay import match_picture

        source = self.rgb
        if source.is_dir():
            found = [source / (path.stem + suffix) for suffix in FORMATS]
            source = next((each for each in found if each.is_file()), source / path.stem)
            if not source.is_file():
                raise PlanewiseError(f"rgb: {self.rgb} holds no picture named {path.stem}")
        shape = (frame.depth.shape[0], frame.depth.shape[1])
        with naming("rgb:"):
            picture = read_colour(source)
        return match_picture(picture, shape)


def _folder_names(paths: list[Path]) -> list[str]:
    """Names of the frames' folders: without endings, but of those that would share one."""
    stems = Counter(path.stem for path in paths)
    names = [path.stem if stems[path.stem] == 1 else path.name for path in paths]
    # Among a.png, a.npy and a.png.npy one's whole name is another's without ending.
    return names if len(set(names)) == len(names) else [path.name for path in paths]


def find_planes(
    depth: NDArray[np.generic],
    camera: Camera,
    sensor: Sensor,
    depth_scale: float | None,
    options: Options,
    rgb: NDArray[np.uint8] | None = None,
) -> tuple[PlaneModel, float, str]:
    """Detect planes; say how many seconds it took, and `Done.out_of_range`."""
    from planewise.detect import observe_and_find

    started = time.perf_counter()
    seen, model = observe_and_find(depth, camera, sensor, options, depth_scale=depth_scale, rgb=rgb)
    seconds = time.perf_counter() - started
    beyond = seen.out_of_range if 2 * seen.count < seen.image.present else ""
    return model, seconds, "" if beyond in model.note else beyond
