"""Every compiled loop of the labels against its plain NumPy version."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from planewise.kernels import creases, labels, units
from planewise.kernels.cells import UNIT
from planewise.spatial.cells import SIDE

from . import label_oracles as oracles
from .conftest import quilt

SIGMA = 1e-3
PLANES = np.array([[0.50, 0.03, -0.02], [0.53, -0.05, 0.04], [0.47, 0.08, 0.06]])
RANGING = 500.0, 3.0, 2.0  # as of readings that are ranges
NULL, DIFFERING = 9.0, 1.0


def coordinates(shape):
    """x and y of pixels, the principal point off the middle."""
    i, j = np.indices(shape, dtype=np.float32)
    return (j - np.float32(0.4 * shape[1])) / 100, (i - np.float32(0.7 * shape[0])) / 100


def readings(rng, planes, label, holes=0.0):
    """w, p, x, y of labelled planes with white noise; no reading at some pixels."""
    x, y = coordinates(label.shape)
    t = np.asarray(planes)[label]
    p = rng.uniform(0.7, 1.4, label.shape).astype(np.float32) / np.float32(SIGMA**2)
    p[rng.random(label.shape) < holes] = 0
    w = t[..., 0] + t[..., 1] * x + t[..., 2] * y + rng.normal(0, SIGMA, label.shape)
    return np.where(p > 0, w, 0).astype(np.float32), p, x, y


def by_depth(rng, w, x, y, low, high):
    """A table of variances by depth, and those of the readings in it; the last row is too near."""
    table = SIGMA**2 * rng.uniform(low, high, int(RANGING[0] / w[w > 0].min()))
    return table, of_table(table, w, x, y)


def of_table(table, w, x, y):
    """What a table says of readings: row per_metre times range, times (range / z)^2."""
    per_metre, a, b = RANGING
    stretch = 1 + a * np.square(x, dtype=float) + b * np.square(y, dtype=float)
    row = per_metre * np.sqrt(stretch) / np.where(w > 0, w, 1).astype(np.float64)
    return stretch * table[np.minimum(np.rint(row).astype(int), len(table) - 1)]


class Marks:
    """Labels with a margin, where all free pixels wait."""

    def __init__(self, label, there, free=None):
        height, width = label.shape
        chunks = -(-(width + 1 + SIDE) // labels.CHUNK)
        self.inner = np.s_[1 : height + 1, 1 : width + 1]
        self.label = np.full((height + 2, chunks * labels.CHUNK), labels.NONE)
        self.label[self.inner] = np.where(there, label, labels.NONE)
        self.state = np.full(self.label.shape, labels.FIXED)
        free = there if free is None else there & free
        self.state[self.inner] = np.where(free, 1, labels.FIXED)
        self.busy = np.ones((height + 2, chunks), np.bool_)
        self.seen = np.ones((height + 2, chunks), np.bool_)

    @property
    def flat(self):
        return [image.reshape(-1) for image in (self.label, self.state, self.busy, self.seen)]

    def labels(self):
        out = np.full((self.inner[0].stop - 1, self.inner[1].stop - 1), 9, np.uint16)
        labels.without_margin(self.label, out)
        return out


# Labels


def scattered_cells(rng, seed):
    """Cells of some labels, readings on their planes, some far off and some not there."""
    shape = (50 + seed, 61 - seed)
    cells = -(-shape[0] // SIDE), -(-shape[1] // SIDE)
    grid = np.arange(cells[0] * cells[1], dtype=np.int32).reshape(cells)
    number = quilt(rng, cells, 4).reshape(-1).astype(np.int16)
    grid[rng.random(cells) < 0.05] = -1
    truth = number.reshape(cells).repeat(SIDE, 0).repeat(SIDE, 1)[: shape[0], : shape[1]]
    table = np.vstack((np.zeros((1, 3)), PLANES))
    w, p, x, y = readings(rng, np.array([[0.5, 0, 0], *PLANES]), truth, holes=0.03)
    p[20:30, 20:30] = 0
    w = w + np.float32(20 * SIGMA) * (rng.random(shape) < 0.02)
    return grid, number, (np.where(p > 0, w, 0).astype(np.float32), p, x, y), table


@pytest.mark.parametrize("seed", range(4))
def test_pixels_laid_out_and_those_that_wait(seed):
    rng = np.random.default_rng(seed)
    grid, number, (w, p, x, y), table = scattered_cells(rng, seed)
    marks = Marks(np.zeros(p.shape), p > 0)
    label, fixed, apart = oracles.lay_out(grid, number, p, SIDE)
    marks.label[1:-1], marks.state[1:-1] = 7, 7
    coarse = np.empty((grid.shape[0] + 2, grid.shape[1] + 2), np.int16)
    beside = np.empty(grid.shape, np.bool_)
    count = np.zeros(grid.shape, np.uint8)
    for r, c, pixels in oracles.cells_of(p, SIDE):
        count[r, c] = (pixels > 0).sum()
    bands = ((0, 3), (3, len(grid)))  # one after the other, as threads have them
    for band in bands:
        images = coarse, beside, marks.label, marks.state
        labels.lay_out(grid, number, count, p, *band, *images)
    assert_array_equal(beside, apart)
    assert_array_equal(marks.label[marks.inner], label)
    assert_array_equal(marks.state[marks.inner], np.where(fixed, labels.FIXED, 0))
    margin = np.ones(marks.label.shape, bool)
    margin[marks.inner] = False
    assert (marks.label[margin] == labels.NONE).all()
    assert (marks.state[margin] == labels.FIXED).all()

    marks.busy[:] = False
    for band in bands:
        coordinates = (x[:1], y[:, :1].copy()) if seed % 2 else (x, y)
        images = coarse, beside, w, p, *coordinates
        labels.find_waiting(*images, table, NULL, *band, marks.state, marks.busy)
    exact = oracles.waiting(grid, number, fixed, w, p, x, y, table, NULL, SIDE)
    assert_array_equal(marks.state[marks.inner] == 1, exact)
    assert 0 < exact.sum() < (p > 0).sum()
    chunks = (marks.state == 1).reshape(*marks.busy.shape, labels.CHUNK).any(2)
    assert (marks.busy >= chunks).all()
    # No other pixel changes but beside a change.
    table_by_depth, variance = by_depth(rng, w, x, y, 1.5, 2.5)
    label = np.maximum(label, 0)
    cost = oracles.costs(w, x, y, variance, table, np.zeros(4), NULL)
    swept = oracles.sweep_labels(label, ~fixed, cost, p > 0, DIFFERING)
    images = [image.reshape(-1) for image in (w, x, y)]
    costs = (table_by_depth, RANGING, table, np.zeros(4), NULL, DIFFERING, 1)
    labels.label_pixels(*marks.flat, marks.label.shape[1], *images, w.shape[1], *costs)
    assert_array_equal(marks.labels(), swept)
    assert (swept != label).any()


def wavy(rng, shape=(26, 31), planes=4, pieces=14):
    """Labels of random pieces with ragged borders, 0 among them, and readings with holes."""
    label = quilt(rng, shape, planes, pieces)
    stray = rng.random(shape) < 0.1
    label[stray] = rng.integers(0, planes, shape)[stray]
    table = np.array([[0.5, 0, 0], *PLANES])[:planes]
    images = readings(rng, table, quilt(rng, shape, planes, pieces), holes=0.08)
    label[images[1] == 0] = 0
    return label, images, np.vstack((np.zeros((1, 3)), table[1:]))


def labelling(seed):
    rng = np.random.default_rng(seed)
    label, (w, p, x, y), planes = wavy(rng)
    alike = x[:1], y[:, :1].copy()  # of a straight image, one row and one column will do
    table, variance = by_depth(rng, w, x, y, 1, 2)
    lateral = SIGMA**2 * rng.uniform(0, 1, len(planes))
    free = rng.random((9, 11)).repeat(3, 0).repeat(3, 1)[: label.shape[0], : label.shape[1]] > 0.3
    cost = oracles.costs(w, x, y, variance, planes, lateral, NULL)

    def swept(start, sweeps):
        marks = Marks(start, p > 0, free)
        images = [image.reshape(-1) for image in (w, *(alike if seed % 2 else (x, y)))]
        costs = (table, RANGING, planes, lateral, NULL, DIFFERING, sweeps)
        changed = labels.label_pixels(
            *marks.flat, marks.label.shape[1], *images, w.shape[1], *costs
        )
        return marks.labels(), changed

    return label, swept, free, cost, p > 0


@pytest.mark.parametrize("seed", range(6))
def test_sweeps_over_pixels_that_wait_are_those_over_all(seed):
    label, swept, free, cost, there = labelling(seed)
    exact = label
    for sweep in range(6):
        before = exact
        exact = oracles.sweep_labels(before, free, cost, there, DIFFERING, sweep % 2 == 1)
        out, changed = swept(label, sweep + 1)
        assert_array_equal(out, exact)
        assert changed >= (exact != before).sum()
    assert (exact != label).any()


@pytest.mark.parametrize("seed", range(4))
def test_sweeps_of_labels_never_cost_more_and_settle(seed):
    label, swept, free, cost, there = labelling(seed)
    paid = [oracles.energy(label, cost, there, DIFFERING)]
    for sweeps in range(1, 8):
        out = swept(label, sweeps)[0]
        paid.append(oracles.energy(out, cost, there, DIFFERING))
        assert_array_equal(out[~free | ~there], label[~free | ~there])
    assert paid[1] < paid[0]
    assert (np.diff(paid) <= 1e-9).all()
    settled, changed = swept(label, 50)
    assert changed == 0
    again, changed = swept(settled, 1)
    assert changed == 0
    assert_array_equal(again, settled)


def test_borders_lie_in_chunks_that_were_seen():
    rng = np.random.default_rng(0)
    label = quilt(rng, (40, 90), 4)
    w, p, x, y = readings(rng, np.array([[0.5, 0, 0], *PLANES]), quilt(rng, (40, 90), 4, 9))
    marks = Marks(label, p > 0)
    marks.seen[:] = False
    images = [image.reshape(-1) for image in (w, x, y)]
    table, _ = by_depth(rng, w, x, y, 1, 2)
    costs = (
        table,
        RANGING,
        np.vstack((np.zeros((1, 3)), PLANES)),
        np.zeros(4),
        NULL,
        DIFFERING,
        6,
    )
    labels.label_pixels(*marks.flat, marks.label.shape[1], *images, 90, *costs)
    swept = marks.labels().astype(int)
    changed = swept != label
    assert changed.any()
    chunk = (np.arange(90) + 1) // labels.CHUNK
    for i, j, k, *_ in oracles.borders(swept):
        ends = (i, j), (i + k, j + 1 - k)
        if any(changed[end] for end in ends):
            assert all(marks.seen[r + 1, chunk[c]] for r, c in ends)


# Units


def random_units(seed, shape=(40, 47), planes=4):
    """Labels of pixels, and units of one cell and of four."""
    rng = np.random.default_rng(seed)
    label = quilt(rng, shape, planes).astype(np.uint16)
    rows, columns = (-(-n // SIDE) for n in shape)
    grid, count = np.full((rows, columns), -1, np.int32), 0
    for r in range(0, rows, 2):
        for c in range(0, columns, 2):
            whole = rng.random() < 0.5
            for i in range(r, min(r + 2, rows)):
                for j in range(c, min(c + 2, columns)):
                    if rng.random() < 0.9:
                        grid[i, j] = count
                        count += not whole
            count += whole
    grid = np.where(grid >= 0, np.unique(grid, return_inverse=True)[1].reshape(grid.shape) - 1, -1)
    segments = rng.uniform(0.5, 2, (grid.max() + 1, 13))
    return label, grid.astype(np.int32), segments


@pytest.mark.parametrize("seed", range(4))
def test_units_inside_labels_their_sums_and_correlations(seed):
    label, grid, rows = random_units(seed)
    inside = np.full(len(rows), 9, np.int32)
    p = np.ones(label.shape, np.float32)
    p[np.random.default_rng(seed).random(label.shape) < 0.3] = 0
    label[::SIDE, ::SIDE] = np.maximum(label[::SIDE, ::SIDE], 1)
    p[::SIDE, ::SIDE] = 1  # every cell has a reading
    of_readings, seen = np.where(p > 0, label, 0), np.where(p > 0, label.astype(int), -1)
    units.units_inside(of_readings, p, False, grid, inside)
    assert_array_equal(inside, oracles.units_inside(seen, grid, SIDE, len(rows)))
    units.units_inside(of_readings, p, True, grid, inside)
    assert_array_equal(inside, oracles.units_inside(of_readings, grid, SIDE, len(rows)))
    units.units_inside(label, p, True, grid, inside)
    assert_array_equal(inside, oracles.units_inside(label, grid, SIDE, len(rows)))
    assert len(np.unique(inside)) == 4

    sums, count = np.full((4, 13), 9.0), np.full(4, 9)
    units.sum_units(rows, inside, sums, count)
    for n in range(4):
        assert_allclose(sums[n], rows[inside == n].sum(0), rtol=1e-12)
    assert_array_equal(count, np.bincount(inside))

    table, out = np.vstack((np.zeros((1, 3)), PLANES)), np.full((4, 3), 9.0)
    units.correlate(grid, rows, inside, table, np.empty(len(inside)), out)
    assert_allclose(out, oracles.correlation_sums(grid, rows, inside, table), rtol=1e-9)
    assert (out[1:, 2] > 0).all()


def test_rename():
    label = np.random.default_rng(0).integers(0, 5, 100).astype(np.uint16)
    place, out = np.array([0, 3, 1, 1, 2], np.uint16), np.empty(100, np.uint16)
    labels.rename(label, place, out)
    assert_array_equal(out, place[label])


# Creases


def roof(ridge, convex=True, shape=(30, 40), slope=4e-4, tilt=2e-4):
    """Two planes that meet in a line: readings without noise, planes, labels.

    slope, tilt: of w per pixel. The line leans by a pixel in 2 slope / tilt rows.
    """
    x, y = coordinates(shape)
    middle = x[0, 0] + ridge / 100
    s, t = 100 * slope, 100 * tilt
    planes = np.array([[0, 0, 0], [0.5 - s * middle, s, t], [0.5 + s * middle, -s, 0]])
    sides = planes[1:, :1, None] + planes[1:, 1:2, None] * x + planes[1:, 2:, None] * y
    nearest = sides.argmax(axis=0) + 1 if convex else sides.argmin(axis=0) + 1
    w = np.take_along_axis(sides, nearest[None] - 1, 0)[0]
    p = np.full(shape, 1 / SIGMA**2, np.float32)
    return (w.astype(np.float32), p, x, y), planes, nearest


def alike(x, y):
    """One row of x and one column of y, if all are the same."""
    straight = (x == x[0]).all() and (y[:, 0] == y.T).all()
    return (x[:1].copy(), y[:, :1].copy()) if straight else (x, y)


def borders_of(label):
    marks = Marks(label, np.ones(label.shape, bool))
    out = np.empty((2 * label.size, 3), np.int32)
    flat = marks.label.reshape(-1), marks.seen.reshape(-1)
    return out[: creases.find_borders(*flat, marks.label.shape[1], out)]


def creases_of(label, planes, x, y, reach=5):
    """Borders, which planes meet, and in which lines."""
    borders, count = borders_of(label), len(planes)
    crease, lines = np.full((count, count), 9, np.int32), np.empty((count**2, 3))
    found = creases.find_creases(
        borders, label.astype(np.uint16), planes, *alike(x, y), reach, UNIT, crease, lines
    )
    return borders, crease, lines[:found]


def kinds_of(planes, crease, lines):
    """1 for a convex crease, -1 for a concave one, 0 for none: d0 = kind (a0 - b0) / slope."""
    kinds = np.zeros(crease.shape, int)
    for a, b in np.argwhere(crease >= 0):
        if a < b:
            line = lines[crease[a, b]]
            kinds[a, b] = kinds[b, a] = np.sign(line[1:] @ (planes[a] - planes[b])[1:])
    return kinds


@pytest.mark.parametrize("shape", [(3, 4), (17, 16), (40, 50)])
def test_borders(shape):
    label = quilt(np.random.default_rng(shape[0]), shape, 4)
    label[0, 0] = label[-1, -1] = 3
    expected = sorted((i, j, k) for i, j, k, *_ in oracles.borders(label))
    assert_array_equal(borders_of(label), np.reshape(expected, (-1, 3)))


@pytest.mark.parametrize(("convex", "kind"), [(True, 1), (False, -1)])
def test_a_roof_is_convex_and_a_valley_concave(convex, kind):
    (_, _, x, y), planes, label = roof(20, convex)
    assert set(np.unique(label)) == {1, 2}
    kinds = np.zeros((3, 3))
    kinds[1, 2] = kinds[2, 1] = kind
    _, crease, lines = creases_of(label, planes, x, y)
    assert_array_equal(kinds_of(planes, crease, lines), kinds)
    distance = oracles.crease_distance(planes, kinds, 1, 2, x, y)
    assert_allclose(lines[0, 0] + lines[0, 1] * x + lines[0, 2] * y, distance, atol=1e-4)
    across = (np.ascontiguousarray(image.T) for image in (x, y))
    _, crease, lines = creases_of(np.ascontiguousarray(label.T), planes, *across)
    assert_array_equal(kinds_of(planes, crease, lines), kinds)


def test_a_surface_in_front_of_another_does_not_meet_it():
    (_, _, x, y), planes, label = roof(20)
    planes[1, 0] += 0.1
    _, crease, lines = creases_of(label, planes, x, y)
    assert_array_equal(crease, -1)
    assert len(lines) == 0


@pytest.mark.parametrize("seed", range(4))
def test_which_planes_meet(seed):
    rng = np.random.default_rng(seed)
    x, y = coordinates((40, 50))
    planes = np.vstack((np.zeros((1, 3)), rng.normal((0.5, 0, 0), (0.005, 0.05, 0.05), (5, 3))))
    values = planes[1:, :1, None] + planes[1:, 1:2, None] * x + planes[1:, 2:, None] * y
    label = (values.argmax(0) if seed % 2 else np.argsort(values, 0)[1]) + 1
    label[rng.random(label.shape) < 0.12] = 0
    _, crease, lines = creases_of(label, planes, x, y, 3)
    kinds = oracles.crease_kinds(label, planes, x, y, 3)
    assert_array_equal(kinds_of(planes, crease, lines), kinds)
    assert_array_equal(crease >= 0, kinds != 0)
    assert len(lines) == np.count_nonzero(kinds) // 2 > 0


def test_a_crease_beside_missing_readings_is_one():
    (_, _, x, y), planes, label = roof(20)
    ridge = np.flatnonzero(np.diff(label[0]))[0]
    hole = np.zeros(label.shape, bool)
    hole[:, ridge - 6 : ridge - 3] = True
    x, y, holed = (np.where(hole, 0, image) for image in (x, y, label))
    _, crease, lines = creases_of(holed, planes, x, y)
    assert kinds_of(planes, crease, lines)[1, 2] == 1


@pytest.mark.parametrize(("away", "meet"), [(3, True), (9, False)])
def test_planes_meet_if_their_border_is_near_the_line(away, meet):
    (_, _, x, y), planes, label = roof(20, tilt=0.0)
    label = np.roll(label, away, axis=1)
    label[:, :away] = label[:, away : away + 1]
    _, crease, lines = creases_of(label, planes, x, y, 5)
    assert len(lines) == (crease[1, 2] >= 0) == meet


@pytest.mark.parametrize("seed", range(6))
def test_crease_offsets(seed):
    rng = np.random.default_rng(seed)
    (w, p, x, y), planes, label = roof(20.0, convex=seed % 2 == 0, slope=2e-3, tilt=5e-4)
    _, crease, lines = creases_of(label, planes, x, y)
    kinds = kinds_of(planes, crease, lines)
    # The border lies up to as far from the line as is looked across it.
    away = seed - 6
    label[:, :away] = label[:, -away:].copy()
    # One plane is a little off, so that the readings tell another line than that of intersection.
    wrong = planes.copy()
    wrong[1, 0] += rng.uniform(-3, 3) * SIGMA
    slope = np.hypot(*(planes[1] - planes[2])[1:]) / UNIT
    lines[0, 0] += kinds[1, 2] * (wrong[1, 0] - planes[1, 0]) / slope
    w = (w + rng.normal(0, SIGMA, w.shape)).astype(np.float32)
    label[rng.random(p.shape) < 0.05] = 0
    table, variance = by_depth(rng, w, x, y, 1, 1.2)
    lateral = SIGMA**2 * np.array([0, 0.1, 0.2])
    limits = 4, (0.5, 5.0)[seed % 2], (1e9, 3.0, 1e9, 1.0)[seed % 4]
    offset = np.empty(1)
    coordinates = alike(x, y) if seed % 2 else (x, y)
    arguments = (crease, lines, wrong, w, *coordinates, table, RANGING, lateral, *limits, offset)
    creases.crease_offsets(borders_of(label), label.astype(np.uint16), *arguments)
    places, cost = oracles.crease_costs(
        label, wrong, kinds, w, x, y, variance, lateral, *limits, (1, 2)
    )
    at = np.argmin(abs(places - offset[0]))
    assert offset[0] == pytest.approx(places[at])
    assert cost[at] == pytest.approx(cost.min())


def strays_of(label, crease, lines, offset, x, y, step=8, room=10_000):
    out = np.empty((room, 3), np.int32)
    arguments = (crease, lines, offset, x, y, step, out)
    return out[: creases.find_strays(borders_of(label), label.astype(np.uint16), *arguments)]


def put(label, planes, crease, lines, offset, images, price=DIFFERING, apart=np.inf):
    """Labels once creases are put in their place; the variance of all readings is alike."""
    w, p, x, y = images
    marks = Marks(label, p > 0)
    marks.state[:] = 0
    variance, none = np.full(1, SIGMA**2), np.zeros(len(planes))
    offset = np.full(len(lines), offset)
    strays = strays_of(label, crease, lines, offset, x, y)
    creases.put_creases(
        strays, marks.label, crease, lines, offset, planes, none, w, x, y, variance,
        (500.0, 0.0, 0.0), price, apart, marks.state, np.empty((label.size, 2), np.int32),
    )  # fmt: skip
    return marks.labels()


@pytest.mark.parametrize("convex", [True, False])
def test_a_ragged_border_becomes_the_line_of_intersection(convex):
    images, planes, label = roof(20.3, convex)
    x, y = images[2:]
    _, crease, lines = creases_of(label, planes, x, y)
    rng = np.random.default_rng(8)
    ragged = label.copy()
    for row, moved in zip(ragged, rng.integers(-3, 4, len(ragged)), strict=True):
        row[:] = np.roll(row, moved)
        row[:5], row[-5:] = row[6], row[-6]
    assert (ragged != label).sum() > 20
    assert_array_equal(put(ragged, planes, crease, lines, 0.0, images), label)
    # A line that lies a pixel further on the side of plane 1 leaves it less.
    moved = put(ragged, planes, crease, lines, 1.0, images, price=10.0)
    kinds = kinds_of(planes, crease, lines)
    distance = oracles.crease_distance(planes, kinds, 1, 2, x, y)
    assert_array_equal(moved, np.where(distance > 1, 1, 2))


def test_a_border_leaves_the_line_where_readings_say_so():
    images, planes, label = roof(20.3, slope=1e-3, tilt=0.0)
    _, crease, lines = creases_of(label, planes, *images[2:])
    # In half of the rows plane 1 goes on for five pixels beyond the line.
    _, p, x, y = images
    truth = label.copy()
    truth[:15, 16:21] = 1
    t = planes[truth]
    seen = (t[..., 0] + t[..., 1] * x + t[..., 2] * y).astype(np.float32), p, x, y
    assert_array_equal(put(truth, planes, crease, lines, 0.0, seen, price=0.5), truth)
    # Not where nothing but noise tells the difference, or a border off the line is dear.
    assert_array_equal(put(truth, planes, crease, lines, 0.0, images, price=0.5), label)
    assert_array_equal(put(truth, planes, crease, lines, 0.0, seen, price=50.0), label)
    # Nor where readings say more against it than they may.
    assert_array_equal(put(truth, planes, crease, lines, 0.0, seen, price=50.0, apart=30.0), truth)
    assert_array_equal(put(truth, planes, crease, lines, 0.0, images, price=0.5, apart=30.0), label)


def test_a_surface_that_touches_its_plane_nowhere_is_on_it():
    images, planes, label = roof(20.3, slope=1e-3, tilt=0.0)
    w, p, x, y = images
    _, crease, lines = creases_of(label, planes, x, y)
    hole = np.zeros(label.shape, bool)
    hole[:, 12:14] = hole[14:16, :21] = hole[14:16, 24:] = True
    seen = np.where(hole, 0, label)
    stray = seen.copy()
    stray[:14, 14:21] = 1
    images = (w, np.where(hole, 0, p), x, y)
    assert_array_equal(put(stray, planes, crease, lines, 0.0, images, price=2.0), seen)


def test_a_border_far_from_the_line_is_put_there_if_planes_meet():
    images, planes, label = roof(20.3, tilt=0.0)
    _, crease, lines = creases_of(label, planes, *images[2:])
    away = np.roll(label, 12, axis=1)
    away[:, :12] = label[:, :1]
    whole = (away, planes, crease, lines, 0.0, images)
    assert_array_equal(put(*whole), label)
    assert_array_equal(put(away, planes, 0 * crease - 1, lines, 0.0, images), away)


def test_putting_creases():
    paid = np.sum([compare_put_creases(seed) for seed in range(12)], axis=0)
    assert paid.min() > 4


def compare_put_creases(seed):
    """Hold labels against the oracle's; returns how often it paid and not."""
    rng = np.random.default_rng(seed)
    # All three planes meet in the middle.
    slopes = rng.uniform(-0.1, 0.1, (3, 2))
    middle = [image[13, 15] for image in coordinates((26, 31))]
    planes = np.vstack((np.zeros(3), np.column_stack((0.5 - slopes @ middle, slopes))))
    label = quilt(rng, (26, 31), 4, 14)
    w, p, x, y = readings(rng, planes, rng.integers(1, 4, label.shape), holes=0.08)
    label[p == 0] = 0
    kinds = np.zeros((4, 4), np.int8)
    kinds[1, 2] = kinds[2, 1] = 1
    kinds[1, 3] = kinds[3, 1] = -1
    crease, lines = np.full((4, 4), -1, np.int32), np.empty((2, 3))
    for number, (a, b) in enumerate(((1, 2), (1, 3))):
        crease[a, b] = crease[b, a] = number
        difference = planes[a] - planes[b]
        slope = np.hypot(difference[1], difference[2]) / UNIT
        lines[number] = kinds[a, b] * difference / slope
    shift = rng.uniform(-1, 1, 2)
    offset = np.zeros((4, 4))
    offset[1, 2], offset[1, 3] = shift
    table, variance = by_depth(rng, w, x, y, 1, (4, 20)[seed % 2])
    lateral, price = SIGMA**2 * rng.uniform(0, 1, 4), (1.0, 4.0)[seed // 6]
    border, straight = (crease, lines, shift), (alike(x, y) if seed % 2 else (x, y))
    strays = strays_of(label, *border, *straight, 3 + seed % 2)
    assert_array_equal(strays, oracles.strays(label, planes, kinds, offset, x, y, 3 + seed % 2))
    assert_array_equal(strays_of(label, *border, *straight, 3 + seed % 2, 5), strays[:5])
    cost = np.minimum(oracles.costs(w, x, y, variance, planes, lateral, NULL), 8.0)
    expected, paid = oracles.put_creases(label, strays, cost, planes, kinds, offset, x, y, price)
    marks = Marks(label, p > 0)
    marks.state[:] = 0
    creases.put_creases(
        strays, marks.label, *border, planes, lateral, w, *straight, table, RANGING,
        price, np.inf, marks.state, np.empty((label.size, 2), np.int32),
    )  # fmt: skip
    assert_array_equal(marks.labels(), expected)
    return paid
