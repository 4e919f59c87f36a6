"""Rules of the spatial search, each on numbers that it alone decides."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise import scenes
from planewise.information import plane_information
from planewise.kernels.cells import COUNT, FREE, UNIT
from planewise.runtime.workspace import Workspace
from planewise.spatial import folds, labels, search, solution, splitting
from planewise.spatial.cells import cells_of
from planewise.spatial.dividing import divided
from planewise.spatial.faces import LabelPixels
from planewise.spatial.frame import frame_of
from planewise.spatial.frame_error import FrameError
from planewise.spatial.information import GroupData
from planewise.spatial.marks import Marks
from planewise.spatial.pieces import in_pieces
from planewise.spatial.segments import Segments
from planewise.spatial.tame_frame import tame_frame


@pytest.fixture(scope="module")
def parts():
    """Frame and cells of a small room."""
    scene = scenes.room(0, size=(120, 160))
    observation = pw.observe(scene.depth, scene.camera, scene.sensor)
    frame = tame_frame(observation)
    return observation, frame, cells_of(frame, observation.pixel_size)


def with_error(cells, **sizes):
    return replace(cells, error=replace(cells.error, **sizes))


def test_a_reading_on_a_steep_plane_may_lie_farther_off(parts):
    _, _, cells = parts
    affine = np.array([[0.5, 0.3, -0.4], [0.5, 0.0, 0.0]])
    found = labels._lateral(with_error(cells, lateral=0.7), affine)
    assert_allclose(found, [0.7 * 0.25 / UNIT**2, 0.0])


def test_drift_that_may_be_chance_widens_no_label(parts):
    _, frame, cells = parts
    size = {"white": 1.2, "near": 0.3, "local": 0.8}
    drifts, by_chance = (
        labels._variances(frame, with_error(cells, walk=walk, **size)) for walk in (0.4, 0.0)
    )
    table = frame.table
    shared = 0.3 * (table.shared + table.step)
    assert_allclose(by_chance, 1.2 * (table.white + table.step) + shared)
    assert_allclose(drifts, by_chance + 1.5 * 0.8 * table.drift)


NULL, WHITE = 9.0, 0.25  # nats of no plane, and the size of the error


@pytest.fixture
def wall():
    """Frame and cells of a wall, twice the row of its plane, variances of readings, and marks."""
    camera = pw.PinholeCamera(fx=50, fy=50, cx=20, cy=15)
    observation = pw.observe(np.full((30, 45), 2.0), camera, pw.Sensor(noise=0.01))
    frame = frame_of(observation)
    cells = with_error(cells_of(frame, observation.pixel_size), white=WHITE, lateral=0.0)
    rows = cells.rows.sum(axis=0)[None].repeat(2, axis=0)
    variance = np.full(frame.table.white.size, WHITE / frame.p[0, 0])
    return frame, cells, rows, variance, Marks.of(frame.w.shape, Workspace())


def set_off(frame, where, nats):
    """Move readings off their wall, by so many nats."""
    frame.w[where] += np.sqrt(2 * nats * WHITE / frame.p[where])


@pytest.mark.parametrize(("nats", "label"), [(NULL + 9, 1), (NULL + 13, 0)])
def test_a_pixel_off_its_plane_gets_a_look_beside_a_border(wall, nats, label):
    """One in the middle of a cell: no plane takes the nats of its border, too, 10.9."""
    frame, cells, rows, variance, marks = wall
    number = np.where(np.arange(len(cells.rows)) == cells.grid[6, 8], 2, 1).astype(np.int16)
    there = np.argwhere(number[cells.grid] == 2).min(axis=0)
    near = 3 * there[0] - 2, 3 * there[1] + 1
    set_off(frame, near, nats)
    labels._label_pixels(frame, cells, number, rows, variance, NULL, marks, Workspace())
    assert marks.label[near[0] + 1, near[1] + 1] == label


@pytest.mark.parametrize(("nats", "label"), [(0.0, 2), (8.0, 0)])
def test_what_lies_about_a_second_face_is_on_it_if_its_plane_is_there(wall, nats, label):
    frame, cells, rows, variance, marks = wall
    found = np.ones(frame.w.shape, np.uint16)
    face, hole = np.s_[9:21, 20:40], np.s_[12:18, 24:36]
    marks.label[:], marks.state[:], marks.seen[:] = -1, 0, False
    marks.label[1:31, 1:46], marks.seen[3, 0] = 1, True
    rows[0, 6:9] *= 1.5  # the face is on the wall, its neighbours are on a plane far off
    frame.w[:] *= 1.5
    frame.w[face] /= 1.5
    set_off(frame, hole, nats)
    found[face] = 2
    found[hole] = marks.label[13:19, 25:37] = 0
    pixels = np.flatnonzero(found == 2).astype(np.int32)
    labels._look_again(frame, cells, rows, variance, NULL, marks, found, pixels)
    changed = marks.label[1:31, 1:46]
    assert_array_equal(changed[hole], label)
    found[hole] = label
    assert_array_equal(changed, found)
    # Borders are looked for where labels changed before, and where they did now.
    assert marks.seen[3, 0]
    assert marks.seen[10:22, 21 // 16 : 40 // 16 + 1].all()


def test_facets_of_smooth_surfaces_pay_for_borders_at_which_these_turn(parts):
    _, frame, cells = parts
    knees = []
    for turning in (0.0, 2.5):
        error = replace(FrameError(), drifting=0.0, turning=turning)
        charges = search.Charges.of(replace(cells, error=error), frame.sectors, 20.0)
        knees.append(charges.border[2])
    assert knees[1] - knees[0] == pytest.approx(2.5)


def test_the_farther_off_the_less_error_drifts_before_cells_are_looked_at_again(parts, monkeypatch):
    _, frame, cells = parts
    limits = []

    def far_off(rows, drift, segment, place, planes, limit, off):
        limits.append(limit)
        return 0

    monkeypatch.setattr(search, "loops", SimpleNamespace(far_off=far_off))
    segments = SimpleNamespace(rows=cells.rows[:1], of_unit=np.zeros(len(cells.rows), np.int32))
    for drifting in (1.0, 0.25):
        search._looked_at_again(
            with_error(cells, drifting=drifting), frame.sectors, segments, np.ones(1),
            np.ones(1, np.bool_), 20.0, 0.0, None,
        )  # fmt: skip
    assert limits == [search._OFF, 4 * search._OFF]


@pytest.fixture
def book(monkeypatch):
    """What `_paying` asks the ledger for: a curve that some list of planes makes least."""
    asked = []

    def book_of(groups, data, mask, range, resolution, order):
        asked.append(order.tolist())
        return SimpleNamespace(curve=np.array([0.0, -50.0, -90.0, -80.0, -95.0]))

    monkeypatch.setattr(solution, "book_of", book_of)
    return asked


def test_of_planes_that_hardly_pay_those_go_without_which_phi_is_lower(book):
    cost = plane_information(3, 10.0, 0.001)
    worth = -cost * np.array([2.0, 3.0, 0.5, 2.5])  # the third does not pay
    data = GroupData(0.0, worth, worth, worth, np.zeros(5))
    pays = solution._paying(None, data, None, 10.0, 0.001, cost, cost)
    # Best first, those that do not pay behind: Phi of the first two is least among these.
    assert book == [[1, 3, 0, 2]]
    assert_array_equal(pays, [False, True, False, True])


def test_planes_that_lower_phi_do_not_go_with_one_before_them_that_raises_it(monkeypatch):
    curve = np.array([0.0, -50.0, -90.0, -80.0, -85.0])
    monkeypatch.setattr(solution, "book_of", lambda *_: SimpleNamespace(curve=curve))
    cost = plane_information(3, 10.0, 0.001)
    worth = -cost * np.array([2.0, 3.0, 1.5, 2.5])
    data = GroupData(0.0, worth, worth, worth, np.zeros(5))
    pays = solution._paying(None, data, None, 10.0, 0.001, cost, cost)
    assert_array_equal(pays, [False, True, True, True])  # the third by worth raises it
    curve[4] = -95.0  # with the fourth Phi is lower than without both
    assert solution._paying(None, data, None, 10.0, 0.001, cost, cost).all()


def test_where_all_planes_clearly_pay_no_list_of_them_is_looked_at(book):
    worth = np.full(3, -1e6)
    data = GroupData(0.0, worth, worth, worth, np.zeros(4))
    assert solution._paying(None, data, None, 10.0, 0.001, 100.0, 100.0).all()
    assert not book


LOOKS = {  # how much of the price of a plane both save, which bend; whether a search is made again
    "nothing bends": ((9.0, 9.0), (False, False), False),
    "the wide one bends": ((9.0, 9.0), (True, False), True),
    "the wide one bends and hardly pays": ((0.9, 9.0), (True, False), False),
    "the narrow one bends": ((9.0, 9.0), (False, True), False),
    "both bend and the wide one hardly pays": ((0.9, 9.0), (True, True), False),
}
CLOSER = {  # Phi, what both save and which bend then; whether that is taken
    "lower": (99.0, (9.0, 9.0), (False, False), True),
    "higher": (101.0, (9.0, 9.0), (False, False), False),
    "lower, and one bends": (99.0, (9.0, 9.0), (False, True), False),
    "lower, and what bends hardly pays": (99.0, (9.0, 0.9), (False, True), True),
}


@pytest.fixture
def solved(parts, monkeypatch):
    """How often `solve` searches for given solutions, a wide and a narrow plane, and its choice."""
    observation, frame, cells = parts
    told = 0.5 * cells.drift
    mask = np.ones(frame.w.shape, np.uint16)
    mask[:3, :3] = 2
    price = solution._SURE * solution.prices.LEAST
    price *= plane_information(3, observation.range, observation.resolution)

    def solve(*given, left_out=0.0):
        drifts, left = [], list(given)

        def judged(*_, **__):
            information, saved, bent = left.pop(0)
            found = SimpleNamespace(
                labels=mask,
                affine=np.zeros((2, 3)),
                significance=price * np.array(saved),
                left_out=left_out * observation.count,
            )
            return SimpleNamespace(information=information, bent=np.array(bent), found=found)

        monkeypatch.setattr(solution, "segment", lambda _, __, cells, **___: drifts.append(cells))
        monkeypatch.setattr(solution, "judged", judged)
        chosen = solution.solve(
            observation, frame, replace(cells, told_drift=told), significance=0.0,
            workspace=Workspace(),
        )  # fmt: skip
        assert_array_equal([each.drift for each in drifts], [cells.drift, told][: len(drifts)])
        return len(drifts), chosen.information

    return solve


@pytest.mark.parametrize("name", LOOKS)
def test_a_search_is_made_again_where_a_wide_plane_that_clearly_pays_bends(solved, name):
    saved, bent, again = LOOKS[name]
    closer = 90.0, (9.0, 9.0), (False, False)
    assert solved((100.0, saved, bent), closer) == ((2, 90.0) if again else (1, 100.0))


def test_a_search_is_made_again_where_much_is_on_no_plane(solved):
    first, closer = ((phi, (9.0, 9.0), (False, False)) for phi in (100.0, 90.0))
    assert solved(first, closer, left_out=0.04) == (1, 100.0)
    assert solved(first, closer, left_out=0.06) == (2, 90.0)


@pytest.mark.parametrize("name", CLOSER)
def test_readings_are_taken_at_their_word_if_phi_is_lower_and_nothing_bends(solved, name):
    *closer, taken = CLOSER[name]
    first = 100.0, (9.0, 9.0), (True, False)
    assert solved(first, closer) == (2, closer[0] if taken else 100.0)


@pytest.mark.parametrize("broken", [False, True])
@pytest.mark.parametrize("phi", [99.0, 101.0])
def test_the_error_that_makes_phi_lower_is_taken_where_it_may_be_either(
    parts, monkeypatch, phi, broken
):
    """But for that by which planes of the other are in pieces."""
    observation, frame, cells = parts
    steadier = replace(cells, drift=cells.drift / 9, told_drift=cells.drift / 9)
    cells = replace(cells, told_drift=cells.drift, other=steadier)
    searched, left = [], [100.0, phi]

    def judged(_, __, cells, *___, **____):
        return SimpleNamespace(cells=cells, information=left.pop(0), planes=cells.drift)

    def in_pieces(_, whole, parts):
        assert whole is cells.drift
        assert parts is steadier.drift
        return broken

    monkeypatch.setattr(solution, "segment", lambda _, __, cells, **___: searched.append(cells))
    monkeypatch.setattr(solution, "judged", judged)
    monkeypatch.setattr(solution, "in_pieces", in_pieces)
    chosen = solution.solve(observation, frame, cells, significance=0.0, workspace=Workspace())
    assert searched == [cells, steadier]
    assert chosen.information == (100.0 if broken else min(100.0, phi))
    assert chosen.cells is (cells if broken or phi > 100 else steadier)


def turned(radians, step=0.0):
    """Plane (t0, t1, t2) through a pixel 2 m away, or that much nearer, turned about its column."""
    return [1 / (2 - step), -0.5 * np.tan(radians) * UNIT / FOCAL, 0.0]


FOCAL = 131.25  # of the small room
HALVES = {  # plane of the right half, and its share of a row; whether it is a piece
    "turned by little": (turned(0.15), 0.5, True),
    "turned the other way": (turned(-0.15), 0.5, True),
    "turned by much": (turned(0.25), 0.5, False),
    "a step": (turned(0.0, 0.2), 0.5, False),
    "a step less than a turn makes": (turned(0.0, 0.02), 0.5, True),
    "small": (turned(0.15), 0.006, False),
}


@pytest.mark.parametrize("name", HALVES)
def test_planes_are_in_pieces_where_these_hardly_turn(parts, name):
    plane, share, broken = HALVES[name]
    _, frame, _ = parts
    height, width = frame.w.shape
    assert frame.sectors.mean_focal == pytest.approx(FOCAL)
    everywhere = np.ones((height, width), np.uint16)
    whole = everywhere, np.array([turned(0.0)])
    right = np.zeros((height, width), bool)
    right[:, width // 2 :] = True
    right[: int((1 - 2 * share) * height)] = False
    labels = np.where(right, 3, 1).astype(np.uint16)
    planes = np.array([turned(0.0), turned(1.0), plane])
    assert in_pieces(frame, whole, (labels, planes)) == broken
    assert not in_pieces(frame, whole, whole)
    none = np.zeros_like(everywhere), whole[1]
    assert not in_pieces(frame, none, (labels, planes))
    # Nor are they where the other solution has them, too.
    assert not in_pieces(frame, (labels, planes), (labels, planes))
    labels[labels == 3] = 0
    assert not in_pieces(frame, whole, (labels, planes))


STRIPS = {  # line, cubic and readings, with and without the pixels beside the border; what it is
    "flat": ((1010, 1000, 1000), (805, 800, 800), (False, False)),
    "bends": ((1500, 1020, 1000), (1100, 810, 800), (True, True)),
    "bends beside its border": ((1500, 1020, 1000), (805, 800, 800), (True, False)),
    "bends but beside its border": ((1010, 1000, 1000), (1100, 810, 800), (False, False)),
    "two faces": ((3000, 1600, 1000), (2000, 1100, 800), (True, False)),
    "too few to tell": ((40, 20, 25), (30, 14, 20), (False, False)),
}


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("strip", STRIPS)
def test_what_readings_say_of_a_strip(strip, wide, monkeypatch):
    *chi2, (bent, inside) = STRIPS[strip]
    width = 0.9 * folds._WIDE

    def profiles(*given):
        out, sides = given[-2:]
        out[0], sides[0] = chi2, (width, (2.9 if wide else 3.1) * width)

    monkeypatch.setattr(folds, "kernels", SimpleNamespace(profiles=profiles))
    one = np.array([[1.0] + [0.0] * 12])
    one[0, [3, 5]] = 1.0
    straight = SimpleNamespace(w=None, p=None, sectors=SimpleNamespace(coordinates=(None, None)))
    image, every = np.ones((30, 100), np.uint16), np.array([False, True])
    pixels = LabelPixels.of(image, every, np.array([0.0, 600.0]), Workspace())
    found = folds._strips(straight, 1.0, one, pixels)
    assert found.there.tolist() == [False, not wide]
    assert found.bent.tolist() == [False, bent and not wide]
    assert found.inside.tolist() == [False, inside and not wide]


def test_what_lies_amid_folds_is_one_of_them():
    # 1 and 2 are folds; 3 and then 4 lie amid them, 5 has most of its border with what is none.
    shared = np.zeros((7, 7), np.int64)
    for a, b, sides in (
        (1, 3, 9),
        (2, 3, 9),
        (3, 6, 2),
        (3, 4, 9),
        (4, 6, 5),
        (5, 1, 4),
        (5, 6, 9),
    ):
        shared[a, b] = shared[b, a] = sides
    size = np.array([0, 100, 90, 50, 40, 30, 5000])
    bent = np.isin(np.arange(7), (1, 2))
    found = folds._with_pieces(bent, size, shared)
    assert np.flatnonzero(found).tolist() == [1, 2, 3, 4]
    # What is larger than any of them is no piece of theirs.
    size[3] = 200
    assert np.flatnonzero(folds._with_pieces(bent, size, shared)).tolist() == [1, 2]


def test_planes_that_err_by_more_than_their_frame_have_to_save_more(book):
    worth, even = -np.array([1e6, 1e6, 1e3, 1e3]), -np.array([200.0, 50.0, 200.0, 50.0])
    data = GroupData(0.0, worth, even, worth, np.zeros(5))
    pays = solution._paying(None, data, None, 10.0, 0.001, 100.0, 2e3)
    assert_array_equal(pays, [True, True, True, False])


@pytest.mark.parametrize("pays", [True, False])
def test_what_is_round_is_no_plane_and_saves_nothing(monkeypatch, pays):
    """The second of two segments; a third is split off, which pays or else is round, too."""
    parts, curved = SimpleNamespace(), np.array([False, True, not pays])
    saved, accepted = np.array([50.0, 40.0, 20.0]), np.array([True, True, pays])
    monkeypatch.setattr(search, "split", lambda *_: (parts, curved))
    monkeypatch.setattr(search, "_accept", lambda *_: (saved, accepted))
    charges, before = SimpleNamespace(plane=30.0), np.array([90.0, 80.0])
    found, worth, planes = search._without_bends(
        None, None, None, SimpleNamespace(), before, np.ones(2, np.bool_), charges, 0.0, None
    )
    assert (found is parts) == pays
    assert worth.tolist() == ([50.0, 0.0, 20.0] if pays else [90.0, 0.0])
    assert planes.tolist() == ([True, False, True] if pays else [True, False])


@pytest.mark.parametrize(("beyond", "label"), [(1, 0), (2, 2)])
def test_a_border_leaves_the_line_of_intersection_where_readings_clearly_say_so(beyond, label):
    """A wall that goes on for so many columns before another, from where both planes meet."""
    size, sigma = (120, 160), 0.002
    column = np.arange(size[1]) - 79.5
    w = 0.5 + 2e-4 * np.where(column > beyond, column, -column)
    depth = 1 / w + sigma * np.random.default_rng(0).standard_normal(size)
    camera = pw.PinholeCamera(fx=140, fy=140, cx=79.5, cy=59.5)
    model = pw.detect_planes(depth, camera, pw.Sensor(noise=sigma))
    assert len(model) == 2
    border = (model.labels == model.labels[:, :1]).sum(axis=1) - 80
    assert_array_equal(border, label)


def test_what_bends_clearly_differs_from_its_plane_is_wide_and_correlated(monkeypatch):
    price = 30.0
    cases = np.array(
        [  # excess of chi^2, units, correlation, whether it is a plane; whether it bends
            (61.0, 100, 0.6, True, True),
            (61.0, 48, 0.6, True, True),
            (59.0, 100, 0.6, True, False),
            (61.0, 47, 0.6, True, False),
            (61.0, 100, 0.5, True, False),
            (61.0, 100, np.nan, True, False),
            (61.0, 100, 0.6, False, False),
        ]
    )
    excess, count, correlation, accepted, expected = cases.T

    def residual_squares(rows, of_unit, planes, off):
        off[:, 0], off[:, 1] = count + excess, count

    monkeypatch.setattr(splitting, "kernels", SimpleNamespace(residual_squares=residual_squares))
    monkeypatch.setattr(splitting, "residual_correlation", lambda *_: correlation)
    segments = SimpleNamespace(rows=np.eye(13)[[0] * len(cases)] + 1, of_unit=np.zeros(1, np.int32))
    monkeypatch.setattr(splitting, "affine_planes", lambda rows: rows[:, :3])
    cells = SimpleNamespace(rows=None)
    bent, _, found = splitting._bends(cells, segments, accepted > 0, None, price)
    assert_array_equal(bent, expected > 0)
    assert_allclose(found, excess)


ROUND = {  # chi^2 of a plane, a cubic and two planes, of 100 units; radians; whether it is round
    "round": ((1100, 100, 600), 1.0, True),
    "hardly worse as a plane": ((150, 95, 140), 1.0, False),
    "no smooth surface": ((1100, 260, 1000), 1.0, False),
    "as flat as walls": ((1100, 100, 600), 0.5, False),
    "an edge": ((1100, 100, 600), 2.0, False),
    "hardly worse as two planes": ((1100, 150, 250), 1.0, False),
    "better as two planes": ((1100, 95, 92), 1.0, False),
}


@pytest.mark.parametrize("name", ROUND)
def test_what_is_round(name, monkeypatch):
    (flat, smooth, two), turn, expected = ROUND[name]
    points = np.tile([0.0, 0.0, 1.0, flat / 100], (100, 1))
    for function, value in (("chi2_of_cubic", smooth), ("_turn", turn), ("_chi2_of_two", two)):
        monkeypatch.setattr(splitting, function, lambda *_, value=value: value)
    assert splitting._is_round(points, None, None, None, 30.0) == expected


def test_too_few_points_are_not_on_two_planes():
    points = np.random.default_rng(0).random((30, 4))
    assert np.isfinite(splitting._chi2_of_two(points))
    assert splitting._chi2_of_two(points[:20]) == np.inf


@pytest.mark.parametrize("steps", [False, True])
def test_which_segments_are_split(monkeypatch, steps):
    """Three bend: one too little to be split, one that is not split for what that would save.

    The fourth is no plane, and may only be divided at steps; so is the last, and narrow.
    """
    price, segments = 30.0, SimpleNamespace(rows=np.zeros((5, 13)), of_unit=np.arange(5))
    whole, out = SimpleNamespace(rows=np.zeros((7, 13)), of_unit=np.arange(7)), object()
    segments.rows[:, COUNT] = 200.0, 200.0, 200.0, 200.0, 42.0
    whole.rows[:5, COUNT] = 200.0, 200.0, 200.0, 100.0, 42.0
    whole.rows[5, FREE] = 100.0  # a plane off a step, and the units across the step
    excess = np.array([19.0, 21.0, 21.0, 21.0, 21.0, 21.0, 0.0]) * price
    judged = []

    def bends(cells, given, chosen, sectors, price):
        judged.append(chosen.tolist())
        return chosen.copy(), np.zeros((len(chosen), 3)), excess[: len(chosen)]

    def points(cells, given, planes, bent, sides):
        assert given is (whole if steps else segments)
        return [(s, [0], s, sides) for s in np.flatnonzero(bent).tolist()]

    def divided(given, s, *_):
        return out if s == 1 else None

    for name, function in (
        ("_bends", bends),
        ("sides_within", lambda *_: None),
        ("at_steps", lambda *_: whole if steps else segments),
        ("points_of_segments", points),
        ("_parts", lambda points, *_: None if points == 5 else np.zeros(1, np.intp)),
        ("_is_round", lambda points, *_: True),
        ("divided", divided),
    ):
        monkeypatch.setattr(splitting, name, function)
    cells = SimpleNamespace(rows=np.zeros((7, 13)))
    found, curved = splitting.split(cells, segments, np.arange(5) < 3, None, price)
    assert found is out
    assert judged == [[True] * 4 + [False]] + [[True] * 4 + [False, True, False]] * steps
    assert curved.tolist() == [True, False, False, False, False] + [True, False] * steps


def parts_of_five(saved, small, **options):
    """Parts of a segment of five units: of three, one and one, the last of which may be none."""
    rows = np.zeros((5, 13))
    rows[:, [0, 3, 5, COUNT]] = 1.0
    whole = rows.sum(axis=0)[None]
    whole[0, FREE] = 5.0 * saved
    one = np.ones(1)
    segments = Segments(whole, one, one, one, np.zeros(1, np.int32), np.zeros(5, np.int32))
    part, cells = np.array([0, 0, 0, 1, 2]), SimpleNamespace(rows=rows)
    out = divided(segments, 0, part, np.array([False, False, small]), cells, 300.0, **options)
    if out is not None:
        assert_array_equal(out.of_unit, part)
    return None if out is None else out.rows[:, FREE].tolist()


def test_a_segment_is_divided_if_every_plane_of_it_clearly_saves_something():
    assert parts_of_five(301, small=False) == [903.0, 301.0, 301.0]
    assert parts_of_five(301, small=True) == [903.0, 301.0, 0.0]
    assert parts_of_five(299, small=False) is None
    assert parts_of_five(299, small=True) is None


def test_what_saves_too_little_of_a_segment_is_no_plane_where_not_all_have_to():
    assert parts_of_five(301, small=True, all_pay=False) == [903.0, 301.0, 0.0]
    assert parts_of_five(299, small=True, all_pay=False) is None  # of one plane
    assert parts_of_five(99, small=False, all_pay=False) is None


@pytest.mark.parametrize(("columns", "parts"), [(2, None), (8, 2)])
def test_a_segment_without_a_few_units_is_no_part_of_it(columns, parts):
    """Those may lie across an edge: at most 24 units that stand off a plane leave it whole."""
    number = np.arange(660).reshape(11, 60)
    row, column = np.divmod(np.arange(660), 60)
    off = column >= 60 - columns
    height = off + 0.01 * np.random.default_rng(0).standard_normal(660)
    points = np.stack((0.05 * column + 0.5 * off, 0.05 * row, height, np.full(660, 1e4)), axis=1)
    across, down = (number[:, :-1], number[:, 1:]), (number[:-1], number[1:])
    sides = np.concatenate([np.stack(pair, axis=2).reshape(-1, 2) for pair in (across, down)])
    found = splitting._parts(points, sides, 30.0)
    assert (None if found is None else np.count_nonzero(~found[1])) == parts
