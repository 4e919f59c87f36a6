"""Picture of a model: its planes over the image, with a legend."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planewise.camera import Camera, PinholeCamera
from planewise.drawing.palette import distinct_colours
from planewise.errors import PlanewiseError, needs
from planewise.model import PlaneModel
from planewise.spherical import SphericalCamera
from planewise.wording import counted

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw as Pen

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Light = NDArray[np.float32]  # of a picture, in 0 ... 1

_SMALLEST_HEIGHT = 400  # smaller images are magnified, for the writing to be readable
_LARGEST_WIDTH = 4000  # to which strips are magnified
_TINT = 0.6
_NEAR = 3  # pixels to each side of what is smoothed or looked at together
_MOST_COLUMNS = 3  # of the legend; planes beyond are neither listed nor numbered
_WIDEST = 4  # times their height that small pictures of LiDARs are wide
_INK, _PAPER, _FAINT = (28, 30, 34), (250, 250, 248), (120, 124, 130)


def draw_overlay(
    model: PlaneModel, depth: Array, camera: Camera, *, rgb: Picture | None = None
) -> Picture:
    """Draw the planes of a depth image with their ranks, and a legend beside it.

    Parameters
    ----------
    model : PlaneModel
        Of a depth image.
    depth : ndarray, shape (H, W)
        Metres, NaN where there is no reading.
    camera : Camera
        Its rays shade the relief.
    rgb : ndarray of uint8, shape (h, w, 3), optional
        Picture of the same view; resized if it has another size. ``None`` means that the depth
        itself is shaded.

    Returns
    -------
    ndarray of uint8, shape (H', W', 3)
        The image, magnified by whole numbers if it is small, flat strips less across than down,
        with the legend on its right.

    Raises
    ------
    PlanewiseError
        If `rgb` is no colour picture, or its proportions are not those of the depth image.
    """
    shape = (depth.shape[0], depth.shape[1])
    base = _shade(depth, camera) if rgb is None else _light(match_picture(rgb, shape))
    picture = _tint(base, model.labels, np.isfinite(depth))
    # The few rows of a LiDAR are farther apart than its columns, and magnified alone.
    down = max(1, -(-_SMALLEST_HEIGHT // depth.shape[0]))
    across = min(down, max(1, _LARGEST_WIDTH // depth.shape[1]))
    if isinstance(camera, SphericalCamera):
        across = 1
    picture = picture.repeat(down, axis=0).repeat(across, axis=1)
    labels = model.labels.repeat(down, axis=0).repeat(across, axis=1)
    _outline(picture, labels)
    return annotate(picture, labels, model)


def draw_small(
    labels: NDArray[np.uint16],
    height: int,
    *,
    depth: Array | None = None,
    camera: Camera | None = None,
    rgb: Picture | None = None,
) -> Picture:
    """Draw the planes of a frame with their ranks, some `height` pixels high, without legend.

    Parameters
    ----------
    labels : ndarray of uint16, shape (H, W)
        0 for no plane, j for the j-th best.
    height : int
        One of so many rows and columns is taken that the picture is nearest to this height. The
        few rows of a LiDAR are magnified to it.
    depth, camera
        As for `draw_overlay`; ``None`` means that it is not known, and planes are drawn alone.
    rgb : ndarray of uint8, shape (h, w, 3), optional
        What to draw over instead of the depth.

    Returns
    -------
    ndarray of uint8, shape (H', W', 3)

    Raises
    ------
    PlanewiseError
        If `rgb` is no colour picture, or its proportions are not those of the depth image.
    """
    shape = (labels.shape[0], labels.shape[1])
    step = across = max(1, round(shape[0] / height))
    if isinstance(camera, SphericalCamera):
        across = max(1, round(shape[1] / (_WIDEST * height)))
    every = (slice(step // 2, None, step), slice(across // 2, None, across))
    labels = labels[every]
    valid = np.ones(labels.shape, bool) if depth is None else np.isfinite(depth[every])
    if rgb is not None:
        picture = match_picture(rgb, shape)
        base = _light(picture[every] if across != step else match_picture(picture, labels.shape))
    elif depth is None or camera is None:
        base = np.full((*labels.shape, 3), 0.6, np.float32)
    elif isinstance(camera, PinholeCamera):
        base = _shade(depth[every], camera.scaled(1 / step))
    else:
        base = _shade(depth, camera)[every]
    picture = _tint(base, labels, valid)
    if isinstance(camera, SphericalCamera):
        up = max(1, round(height / shape[0]))
        picture, labels = picture.repeat(up, axis=0), labels.repeat(up, axis=0)
    _outline(picture, labels)
    with needs("pillow", "drawing"):
        from PIL import Image, ImageDraw
    canvas = Image.fromarray(picture)
    _write_ranks(ImageDraw.Draw(canvas), labels, max(13, canvas.width // 40))
    return np.asarray(canvas)


def match_picture(rgb: Picture, shape: tuple[int, int]) -> Picture:
    """Bring a picture to the size of the depth image whose view it shows.

    Parameters
    ----------
    rgb : ndarray of uint8, shape (h, w, 3)
        Any size of the same proportions.
    shape : (height, width)
        Of the depth image.

    Raises
    ------
    PlanewiseError
        If it is no colour picture, or of other proportions.
    """
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8:
        raise PlanewiseError(
            f"rgb: expected uint8 of shape (H, W, 3), got {rgb.dtype} of shape {rgb.shape}"
        )
    if rgb.shape[:2] == shape:
        return rgb
    wide, tall = rgb.shape[1] / shape[1], rgb.shape[0] / shape[0]
    if abs(wide / tall - 1) > 0.02:
        raise PlanewiseError(
            f"rgb: a picture of {rgb.shape[1]} x {rgb.shape[0]} pixels does not show the view of a "
            f"depth image of {shape[1]} x {shape[0]}; it has to be registered to it"
        )
    from PIL import Image

    return np.asarray(Image.fromarray(rgb).resize((shape[1], shape[0]), Image.Resampling.BILINEAR))


def draw_labels(labels: NDArray[np.uint16], rgb: Picture) -> Picture:
    """Draw labelled regions over a picture of the same size, without legend.

    Parameters
    ----------
    labels : ndarray of uint16, shape (H, W)
        0 for no plane.
    rgb : ndarray of uint8, shape (H, W, 3)
        What to draw over.
    """
    picture = _tint(_light(rgb), labels, np.ones(labels.shape, bool))
    _outline(picture, labels)
    return picture


def _shade(depth: Array, camera: Camera) -> Light:
    """Grey relief of the depth, lit from the upper left: shape (H, W, 1) in 0 ... 1."""
    shape = (depth.shape[0], depth.shape[1])
    z = _smooth(depth.astype(np.float32))
    points = np.moveaxis(camera.rays(shape), -1, 0).astype(np.float32) * z
    right, down = (_moved(points, 2, axis) - _moved(points, -2, axis) for axis in (2, 1))
    normal = np.empty_like(points)  # faces the camera
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        normal[i] = down[j] * right[k] - down[k] * right[j]
    upright = isinstance(camera, SphericalCamera)  # z is up, and the lamp a sun
    length = np.sqrt(np.einsum("ihw,ihw->hw", normal, normal))
    lamp = np.array((0.45, 0.60, 0.66) if upright else (-0.45, -0.60, -0.66), np.float32)
    lit = np.einsum("ihw,i->hw", normal, lamp) / np.maximum(length, 1e-12)
    light = 0.55 + 0.45 * np.clip(lit, 0, 1)
    valid = np.isfinite(z)
    near, far = np.percentile(z[valid], (1, 99)).tolist() if valid.any() else (0.0, 1.0)
    with np.errstate(invalid="ignore"):
        fading = 1.0 - 0.2 * np.clip((z - near) / max(far - near, 1e-6), 0, 1)
    grey = np.where(np.isfinite(depth), np.nan_to_num(light * fading, nan=0.5), 0.0)
    return np.asarray(grey[..., None], np.float32)


def _smooth(depth: Light) -> Light:
    """Mean of the readings near each pixel that lie within 3 % of it: noise goes, edges stay."""
    z = depth
    for _ in range(2):
        total, weight, most = np.zeros_like(z), np.zeros_like(z), np.float32(0.03) * z
        for axis in (0, 1):
            for step in range(-_NEAR, _NEAR + 1):
                other = _moved(z, step, axis)
                with np.errstate(invalid="ignore"):
                    near = np.abs(other - z) < most
                np.add(total, other, out=total, where=near)
                weight += near
        z = np.divide(total, weight, np.full_like(z, np.nan), where=weight > 0)
    return z


def _moved(image: Light, step: int, axis: int) -> Light:
    """Shift along an axis; the border is repeated."""
    size = image.shape[axis]
    return image.take(np.arange(step, size + step).clip(0, size - 1), axis)


def _light(picture: Picture) -> Light:
    return np.asarray(picture / np.float32(255), np.float32)


def _tint(base: Light, labels: NDArray[np.uint16], valid: NDArray[np.bool_]) -> Picture:
    """Colour the planes; what belongs to none stays grey, what was not measured goes dark.

    A relief, of one channel, takes their colours; a picture, of three, has them laid over it.
    """
    relief = base.shape[2] == 1
    count = int(labels.max(initial=0))
    colours = _light(np.vstack((np.zeros((1, 3), np.uint8), distinct_colours(count))))
    grey = base if relief else (base @ np.array((0.299, 0.587, 0.114), np.float32))[..., None]
    light = grey if relief else 0.25 + 0.75 * grey
    plain = 0.7 * grey + 0.3 * base  # so that only planes have strong colours
    tinted = colours[labels] * (1.25 * light)
    mixed = tinted if relief else _TINT * tinted + (1 - _TINT) * base
    out = np.where((labels > 0)[..., None], mixed, 0.75 * plain)
    np.copyto(out, 0.30 * plain + 0.02, where=~valid[..., None])
    return np.asarray(np.round(255 * out.clip(0, 1, out=out), out=out), dtype=np.uint8)


def _outline(picture: Picture, labels: NDArray[np.uint16]) -> None:
    """Draw a thin light line on the border of every plane, in place."""
    edge = borders(labels)
    picture[edge] = (0.3 * picture[edge] + 0.7 * 255).astype(np.uint8)


def borders(labels: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Pixels on the borders of planes, but none around single stray ones, which would be hidden.

    Parameters
    ----------
    labels : ndarray of integers, shape (H, W)
        0 for no plane.
    """
    solid = _coherence(labels) >= 0.45
    edge = np.zeros(labels.shape, bool)
    edge[:, 1:] |= (labels[:, 1:] != labels[:, :-1]) & solid[:, 1:] & solid[:, :-1]
    edge[1:] |= (labels[1:] != labels[:-1]) & solid[1:] & solid[:-1]
    return edge


def _coherence(labels: NDArray[np.integer]) -> Array:
    """Share of the square around each pixel that has its label."""
    height, width = labels.shape
    side = 2 * _NEAR + 1
    padded = np.pad(labels, _NEAR, mode="edge")
    same = np.zeros(labels.shape, np.uint8)
    for y in range(side):
        for x in range(side):
            same += padded[y : y + height, x : x + width] == labels
    return np.asarray(same / side**2)


def _anchors(labels: NDArray[np.uint16]) -> dict[int, tuple[int, int, int]]:
    """Most interior place of each label: row, column, and its distance from the border."""
    step = max(1, labels.shape[0] // 160)
    small = labels[step // 2 :: step, step // 2 :: step]
    inner = np.pad(small, 1)
    alive = inner > 0
    layers = alive.astype(np.int32)
    while alive.any():
        same = alive.copy()
        for axis in (0, 1):
            for shift in (-1, 1):
                same &= np.roll(alive, shift, axis) & (np.roll(inner, shift, axis) == inner)
        alive = same
        layers += alive
    layers = layers[1:-1, 1:-1]
    out = {}
    for label in range(1, int(labels.max(initial=0)) + 1):
        depth = np.where(small == label, layers, 0)
        if depth.any():
            best = np.argwhere(depth == depth.max())
            row, column = best[np.hypot(*(best - best.mean(axis=0)).T).argmin()]
            half = step // 2
            out[label] = (
                int(row) * step + half,
                int(column) * step + half,
                int(depth.max()) * step,
            )
    return out


def annotate(
    picture: Picture, labels: NDArray[np.uint16], model: PlaneModel, *, note: str = ""
) -> Picture:
    """Write ranks on the planes and a legend on the right.

    Parameters
    ----------
    picture : ndarray of uint8, shape (H, W, 3)
        What to write on.
    labels : ndarray of uint16, shape (H, W)
        Which plane is seen where.
    model : PlaneModel
        The planes.
    note : str
        Line for the lower left corner.
    """
    with needs("pillow", "drawing"):
        from PIL import Image, ImageDraw, ImageFont
    height, width = labels.shape
    size = max(13, height // 34)
    font, bold = ImageFont.load_default(size), ImageFont.load_default(size + 2)
    row = round(1.55 * size)
    columns = min(_legend_columns(len(model), height, row), _MOST_COLUMNS)
    listed = min(len(model), columns * _legend_lines(height, row))
    panel = columns * 13 * size
    canvas = Image.new("RGB", (width + panel, height), _PAPER)
    canvas.paste(Image.fromarray(picture), (0, 0))
    pen = ImageDraw.Draw(canvas)
    _write_ranks(pen, np.where(labels <= listed, labels, 0), size)
    if note:
        pen.text((size, height - size), note, fill=_FAINT, font=font, anchor="lb")
    left = width + size
    best = "" if listed == len(model) else f", the best {listed}"
    title = f"{counted(len(model), 'plane')}{best}"
    pen.text((left, size), title, fill=_INK, font=bold, anchor="lt")
    if not len(model):
        return np.asarray(canvas)
    top = size + row + row // 3
    per_column = -(-listed // columns)
    colours = distinct_colours(len(model))
    for column in range(columns):
        at = left + column * 13 * size
        pen.text((at + 7.0 * size, top), "nats", fill=_FAINT, font=font, anchor="rt")
        pen.text((at + 11.0 * size, top), "share", fill=_FAINT, font=font, anchor="rt")
    for rank, plane in enumerate(model.planes[:listed], start=1):
        column, line = divmod(rank - 1, per_column)
        at, y = left + column * 13 * size, top + (line + 1) * row
        pen.rounded_rectangle(
            (at, y, at + size, y + size), radius=size // 4, fill=tuple(colours[rank - 1].tolist())
        )
        middle = y + size / 2
        pen.text((at + 2.9 * size, middle), str(rank), fill=_INK, font=font, anchor="rm")
        pen.text((at + 7.0 * size, middle), _short(plane.information), fill=_INK, font=font,
                 anchor="rm")  # fmt: skip
        share = f"{100 * plane.count / model.readings:.1f} %"
        pen.text((at + 11.0 * size, middle), share, fill=_INK, font=font, anchor="rm")
    under = top + (per_column + 1) * row
    if under + size <= height:
        pen.text((left, under), "nats: against outliers", fill=_FAINT, font=font, anchor="lt")
    return np.asarray(canvas)


def _write_ranks(pen: Pen, labels: NDArray[np.uint16], size: int) -> None:
    """Write each rank inside its plane and the picture, but none over that of a better plane."""
    from PIL import ImageFont

    height, width = labels.shape
    written: list[tuple[float, float, float, float]] = []
    for label, (y, x, inside) in _anchors(labels).items():
        font = ImageFont.load_default(size + 2 if inside > size else max(10, size - 3))
        box = pen.textbbox((x, y), str(label), font=font, anchor="mm", stroke_width=2)
        right = max(0, -box[0]) - max(0, box[2] - width)
        down = max(0, -box[1]) - max(0, box[3] - height)
        box = box[0] + right, box[1] + down, box[2] + right, box[3] + down
        if any(
            box[0] < other[2] and other[0] < box[2] and box[1] < other[3] and other[1] < box[3]
            for other in written
        ):
            continue
        written.append(box)
        pen.text((x + right, y + down), str(label), fill="white", font=font, anchor="mm",
                 stroke_width=2, stroke_fill=_INK)  # fmt: skip


def _legend_lines(height: int, row: int) -> int:
    return max(1, height // row - 3)


def _legend_columns(planes: int, height: int, row: int) -> int:
    return max(1, -(-planes // _legend_lines(height, row)))


def _short(nats: float) -> str:
    """In three or four digits, for a column of the legend."""
    size = abs(nats)
    if size >= 999.5e6:
        return f"{nats / 1e9:.2f} G"
    if size >= 999_950:
        decimals = 2 if size < 9.995e6 else 1 if size < 99.95e6 else 0
        return f"{nats / 1e6:.{decimals}f} M"
    return f"{nats / 1000:,.1f} k" if size >= 9950 else f"{nats:,.0f}"
