"""Segment Anything (Kirillov et al., 2023; SAM 2: Ravi et al., 2024) without a prompt.

A regular grid of points asks the network of `transformers` for the objects under them; of its masks
those remain that it trusts, that do not depend on where they are cut off, and that are not found
twice. This is what the authors' generator of masks does; that of `transformers` needs torchvision.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import is_finite, make_counts
from planewise.errors import MissingExtraError, PlanewiseError, in_one_line, needs
from planewise.wording import unusual

if TYPE_CHECKING:
    from planewise.partition.partitioner import View

Masks = NDArray[np.bool_]

_KINDS = ("sam", "sam2", "sam2_video")
_PATH = re.compile(r"[./~\\]|.*[/\\](.*[/\\]|$)")  # no name on the hub, OWNER/NAME, is like that
_OFFSET = 1.0  # of the network's output: how far the cut is moved to see whether a mask is stable


@dataclass(frozen=True, kw_only=True)
class SegmentAnything:
    """Masks of Segment Anything; needs a picture, weights, and the extra ``sam``.

    Parameters
    ----------
    model : str
        Folder with weights as `transformers` writes them, or a name on its hub, of SAM or SAM 2.
    device : str
        Of PyTorch, such as "cpu", "cuda" or "cuda:1".
    stability : float
        Least stability score: overlap of a mask cut off a little higher and a little lower. The
        paper takes 0.98.
    quality : float
        Least overlap with the object that the network itself predicts.
    points : int
        Of the grid, to a side.
    repeated : float
        Overlap of bounding boxes above which the worse of two masks goes.
    batch : int
        Points looked at together.
    """

    model: str = "facebook/sam-vit-huge"
    device: str = "cpu"
    stability: float = 0.98
    quality: float = 0.88
    points: int = 32
    repeated: float = 0.7
    batch: int = 64

    def __post_init__(self) -> None:
        for name in ("stability", "quality", "repeated"):
            value = getattr(self, name)
            if not (is_finite(value) and 0 <= value <= 1):
                raise ValueError(f"{name} must lie in 0 ... 1, got {value!r}")
        make_counts(self, "points", "batch")

    def __call__(self, view: View) -> Masks:
        """Masks of a picture, shape (N, H, W), the most trusted first; they may overlap.

        Raises
        ------
        ValueError
            If there is no picture, or the model cannot be used.
        """
        if view.rgb is None:
            raise ValueError("partition 'sam' needs rgb, a picture of the same view; got none")
        network = self.load()
        masks, scores = network.masks(view.rgb, self)
        return masks[_distinct(_boxes(masks), scores, self.repeated)]

    def load(self) -> _Network:
        """Load the network, which is kept for the next pictures, or say what is missing."""
        return _network(self.model, self.device)

    def describe(self) -> str:
        """Say what it is."""
        name = self.model.rstrip("/\\").replace("\\", "/").rsplit("/", 1)[-1]
        said = f"Segment Anything ({name}), stability of at least {self.stability:.15g}"
        return said + unusual(self, but=("model", "stability"))


@dataclass(frozen=True)
class _Network:
    """A network, and how it wants pictures.

    Attributes
    ----------
    torch : module
    net : torch.nn.Module
    device : torch.device
    settings : dict
        Of its image processor.
    """

    torch: Any
    net: Any
    device: Any
    settings: dict[str, Any]

    def masks(self, rgb: NDArray[np.uint8], options: SegmentAnything) -> tuple[Masks, NDArray[Any]]:
        """Masks (N, H, W) under a grid of points that pass, and their predicted overlap (N,)."""
        torch, shape = self.torch, rgb.shape[:2]
        found, scores = [np.zeros((0, *shape), bool)], [np.zeros(0, np.float32)]
        with torch.inference_mode():
            picture, inner = self._prepared(rgb)
            embeddings = self.net.get_image_embeddings(picture)
            across = (np.arange(options.points) + 0.5) / options.points
            x, y = np.meshgrid(across * inner[1], across * inner[0])
            grid = torch.tensor(np.stack((x, y), axis=-1).reshape(-1, 1, 2), dtype=torch.float32)
            for points in grid.to(self.device).split(options.batch):
                out = self.net(
                    image_embeddings=embeddings,
                    input_points=points[None],
                    input_labels=torch.ones(
                        (1, len(points), 1), dtype=torch.int64, device=self.device
                    ),
                    multimask_output=True,
                )
                score = out.iou_scores[0].flatten()
                trusted = score >= options.quality
                level = self._full_size(out.pred_masks[0].flatten(0, 1)[trusted], inner, shape)
                inside, around = level > _OFFSET, level > -_OFFSET
                stability = inside.sum((1, 2)) / around.sum((1, 2)).clamp(min=1)
                passed = (stability >= options.stability) & (level > 0).any(2).any(1)
                found.append((level[passed] > 0).cpu().numpy())
                scores.append(score[trusted][passed].float().cpu().numpy())
        return np.concatenate(found), np.concatenate(scores)

    def _prepared(self, rgb: NDArray[np.uint8]) -> tuple[Any, tuple[int, int]]:
        """Picture as the network takes it, and the size that it has in there.

        SAM keeps its proportions and fills up a square; SAM 2 stretches it.
        """
        from PIL import Image

        size, pad = self.settings["size"], self.settings.get("pad_size") or {}
        height, width = rgb.shape[:2]
        if "longest_edge" in size:
            ratio = size["longest_edge"] / max(height, width)
            inner = int(height * ratio + 0.5), int(width * ratio + 0.5)
            outer = pad.get("height", size["longest_edge"]), pad.get("width", size["longest_edge"])
        else:
            inner = outer = size["height"], size["width"]
        resized = Image.fromarray(rgb).resize(inner[::-1], Image.Resampling.BILINEAR)
        value = np.asarray(resized, np.float32) * self.settings.get("rescale_factor", 1 / 255)
        value = (value - self.settings["image_mean"]) / self.settings["image_std"]
        whole = np.zeros((3, *outer), np.float32)
        whole[:, : inner[0], : inner[1]] = np.moveaxis(value, -1, 0)
        return self.torch.from_numpy(whole)[None].to(self.device), inner

    def _full_size(self, level: Any, inner: tuple[int, int], shape: tuple[int, int]) -> Any:
        """Output of the network at the pixels of the picture, (N, H, W)."""
        resize, square = self.torch.nn.functional.interpolate, self.settings["size"]
        level = level[:, None].float()
        if not len(level):
            return level.new_zeros((0, *shape))
        if "longest_edge" in square:
            pad = self.settings.get("pad_size") or {}
            outer = [pad.get(side, square["longest_edge"]) for side in ("height", "width")]
            level = resize(level, outer, mode="bilinear", align_corners=False)
            level = level[..., : inner[0], : inner[1]]
        return resize(level, list(shape), mode="bilinear", align_corners=False)[:, 0]


@lru_cache(maxsize=1)
def _network(model: str, device: str) -> _Network:
    """Load weights; those used last are kept."""
    if _PATH.match(model) and not Path(model).is_dir():
        raise PlanewiseError(
            f"sam: there is no folder {model}; give a folder with weights, or a name on the hub "
            "such as facebook/sam-vit-huge"
        )
    with needs("pillow", "the partition 'sam'", "sam"):
        import PIL  # noqa: F401
    try:
        import torch
        from transformers import AutoConfig, AutoModelForMaskGeneration
        from transformers.image_processing_base import ImageProcessingMixin
        from transformers.utils import logging
    except ImportError as error:
        package = (error.name or "transformers").split(".")[0]
        raise MissingExtraError(package, "the partition 'sam'", "sam") from None
    try:
        place = torch.device(device)
        kind = AutoConfig.from_pretrained(model).model_type
        if kind not in _KINDS:
            raise PlanewiseError(f"sam: {model} is a model of kind {kind}; expected SAM or SAM 2")
        with _no_progress(logging):
            settings, _ = ImageProcessingMixin.get_image_processor_dict(model)
            net = AutoModelForMaskGeneration.from_pretrained(model).eval().to(place)
    except PlanewiseError:
        raise
    except (OSError, ValueError, RuntimeError, AssertionError) as error:
        # A device or weights that are not there; the messages are of many lines.
        detail = in_one_line(error)
        raise PlanewiseError(f"sam: {model} cannot be used on {device}: {detail}") from None
    return _Network(torch, net, place, settings)


@contextmanager
def _no_progress(logging: Any) -> Iterator[None]:
    """No bars on the terminal while weights are loaded."""
    shown = logging.is_progress_bar_enabled()
    logging.disable_progress_bar()
    try:
        yield
    finally:
        if shown:
            logging.enable_progress_bar()


def _boxes(masks: Masks) -> NDArray[np.int64]:
    """Bounding boxes (N, 4): top, left, bottom, right, the last two exclusive."""
    rows, columns = np.any(masks, axis=2), np.any(masks, axis=1)
    return np.stack(
        (
            rows.argmax(axis=1),
            columns.argmax(axis=1),
            rows.shape[1] - rows[:, ::-1].argmax(axis=1),
            columns.shape[1] - columns[:, ::-1].argmax(axis=1),
        ),
        axis=1,
    )


def _distinct(
    boxes: NDArray[np.int64], scores: NDArray[np.floating], most: float
) -> NDArray[np.int64]:
    """Boxes none of which overlaps a better one by more than `most`, the best first."""
    area = (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])
    kept: list[int] = []
    for i in np.argsort(-scores, kind="stable"):
        others = boxes[kept]
        common = np.minimum(boxes[i, 2:], others[:, 2:]) - np.maximum(boxes[i, :2], others[:, :2])
        inner = np.clip(common, 0, None).prod(axis=1)
        if (inner <= most * (area[i] + area[kept] - inner)).all():
            kept.append(int(i))
    return np.array(kept, np.int64)
