"""Options that several commands have: name, kind and help, in one place."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from planewise.files.camera import NOISE_HELP


def optional(help_text: str, *names: str) -> typer.models.OptionInfo:
    """Option that may be left out."""
    return typer.Option(*names, show_default=False, help=help_text)  # type: ignore[no-any-return]


class SearchName(StrEnum):
    """`--search`."""

    joint = "joint"
    sequential = "sequential"


class ObjectiveName(StrEnum):
    """`--objective`."""

    paper = "paper"
    spatial = "spatial"


class ReassignName(StrEnum):
    """`--reassign`."""

    normals = "normals"


CAMERA_HELP = (
    "Preset (see 'planewise info'), fx,fy,cx,cy in pixels, or a JSON, YAML or ROS camera_info "
    "file (with :rect behind its name where images are rectified), each with :radial behind it "
    "where readings are distances rather than depth along z; or a LiDAR's table of angles, or "
    "panorama:1024x512 (width x height). Not needed where an .npz holds K."
)

CameraName = Annotated[str | None, optional(CAMERA_HELP)]
CameraInstead = Annotated[str | None, optional(f"Instead of the dataset's. {CAMERA_HELP}")]
NoiseAsForDetect = Annotated[str | None, optional(f"As for detect: {NOISE_HELP}; or auto.")]
Confidence = Annotated[
    float | None,
    optional(
        "Sequential, without --partition: probability that a plane's sample is pure. Default: 0.99."
    ),
]
InlierRatio = Annotated[
    float | None,
    optional(
        "Sequential, without --partition: share of the readings on the smallest plane. "
        "Default: 0.1."
    ),
]
MaxDepth = Annotated[
    float | None, optional("Largest depth in metres; what is beyond is no reading.")
]
Resolution = Annotated[float | None, optional("Step between two readings in metres.")]
DepthScale = Annotated[
    float | None,
    optional(
        "Metres per unit of an integer image. Default: what an .npz or a dataset states; of other "
        "images the sensor's resolution, which is a millimetre but for LiDARs: 0.001 for their "
        "images in millimetres."
    ),
]
Kind = Annotated[
    str | None, optional("Kind of dataset. Default: whichever the contents look like.")
]
Topic = Annotated[str | None, optional("Topic of a bag, where it has several.")]
CameraTopic = Annotated[
    str | None, optional("Topic of a bag's CameraInfo, where it is not beside the images.")
]
MaxPlanes = Annotated[
    int | None,
    optional(
        "Largest number of planes. Default: none; paper's objective 64; sequential 8, or none with "
        "--partition."
    ),
]
Outlines = Annotated[
    bool,
    typer.Option(
        "--outlines",
        help="Write where the planes lie, too: outlines.json, and meshes as planes.obj and "
        "planes.ply; with --instances each connected piece on its own. Needs the extra 'cloud'.",
    ),
]
SamModel = Annotated[
    str | None,
    optional("Folder or hub name of the weights of Segment Anything, for --partition sam."),
]
SamDevice = Annotated[
    str | None, optional("Where Segment Anything runs: cpu (the default), cuda, cuda:1 ...")
]
Output = Annotated[
    Path,
    typer.Option(
        "-o", "--output", metavar="OUT", show_default=False, help="Folder for the results."
    ),
]
Seed = Annotated[int, typer.Option(help="The same seed gives the same result.")]
Threads = Annotated[int | None, optional("Default: one per processor.")]
Limit = Annotated[int | None, optional("Take only the first so many frames.")]
Every = Annotated[int, typer.Option(help="Take one of so many frames.")]
