from __future__ import annotations

import base64
import hashlib
import io
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import planewise as pw
from planewise import scenes
from planewise.batch import Selection, Store
from planewise.batch.open_source import open_source
from planewise.batch.stored_source import StoredSource, metres
from planewise.drawing.overlay import draw_small
from planewise.drawing.palette import distinct_colours
from planewise.errors import PlanewiseError
from planewise.gallery import Shown, write_gallery
from planewise.gallery.page import _about
from planewise.gallery.records import record_of
from planewise.gallery.thumbnail import HEIGHT, Thumbnail, thumbnail_of
from tests import dataset_files
from tests.batch_sources import Renamed
from tests.command import run
from tests.stores import SIZE, Cloning, Many, Sweeps, make_folder_store, make_store, write_frames

COUNT = 6
KNOWN = COUNT + 2  # and a damaged frame, and one without a reading
HOSTILE = "</script><img src=x onerror=document.title=1>&<!--"
MANY = 2000


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gallery")
    write_frames(folder / "frames", COUNT)
    (folder / "frames" / "room 5.npz").rename(
        folder / "frames" / f"{HOSTILE.replace('/', '∕')}.npz"
    )
    make_folder_store(folder / "frames", folder / "store")
    return folder


@pytest.fixture(scope="module")
def page(made):
    write_gallery(Store(made / "store"), made / "gallery.html")
    return made / "gallery.html"


def records_of(page):
    """Records and pictures, as the script reads them."""
    found = {}
    for kind in ("records", "pictures"):
        blocks = re.findall(
            rf'<script type="application/json" class="{kind}">(.*?)</script>',
            page.read_text(encoding="utf-8"),
        )
        found[kind] = [each for block in blocks for each in json.loads(block)]
    return found["records"], found["pictures"]


def decoded(picture):
    return Image.open(io.BytesIO(base64.b64decode(picture)))


def test_the_page_holds_what_the_store_does(made, page):
    store = Store(made / "store")
    records, pictures = records_of(page)
    assert sorted(each["number"] for each in records) == list(range(KNOWN))
    by_id = {each["id"]: (each, picture) for each, picture in zip(records, pictures, strict=True)}
    failed, none = by_id.pop("broken")
    assert "cannot be read" in failed["failed"]
    assert none is None
    for each in store:
        record, picture = by_id.pop(each.id)
        assert record["information"] == pytest.approx(each.row["information"], abs=0.05)
        assert record["curve"] == pytest.approx(each.row["curve"], abs=0.05)
        planes = np.array(record["planes"], float).reshape(-1, 8)
        assert np.allclose(planes[:, :4], each.planes, atol=5e-5)
        assert planes[:, 5].tolist() == each.plane_table["readings"].to_pylist()
        sizes = [each.plane_table[name].to_numpy() for name in ("rms", "area")]
        assert np.allclose(planes[:, 6:].T, sizes, rtol=1e-4, atol=0, equal_nan=True)
        assert record["over"] == "its picture"
        assert decoded(picture).format == "WEBP"
        assert decoded(picture).size == each.labels.shape[::-1]
    assert not by_id


def test_nothing_of_others_becomes_markup(page):
    text = page.read_text(encoding="utf-8")
    assert "<img src=x" not in text
    assert "onerror=document" in text  # it is there, as text
    names = [each["id"] for each in records_of(page)[0]]
    assert HOSTILE.replace("/", "∕") in names
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', text)
    for kind, pattern in (("style", "<style>(.*?)</style>"), ("script", "<script>(.*?)</script>")):
        (content,) = re.findall(pattern, text, re.DOTALL)
        ours = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{ours}'" in policy.replace("&#39;", "'")
    assert "unsafe" not in policy


def test_ids_and_reasons_that_are_markup_stay_text(made, tmp_path):
    store = make_store(Renamed(made / "frames", [HOSTILE, "b", "ü\u2028"]), tmp_path / HOSTILE[2:])
    info = json.loads((store.path / "store.json").read_text())
    info["source"]["name"] = HOSTILE
    (store.path / "store.json").write_text(json.dumps(info))
    write_gallery(Store(store.path), tmp_path / "g.html")
    text = (tmp_path / "g.html").read_text(encoding="utf-8")
    assert "<img src=x" not in text
    assert "<title>Planes of &lt;/script&gt;" in text
    records, _ = records_of(tmp_path / "g.html")
    assert {each["id"] for each in records} == {HOSTILE, "b", "ü\u2028"}


def test_pages_ask_for_nothing_else(page):
    text = page.read_text(encoding="utf-8")
    addresses = set(re.findall(r"https?://[^\"' )]+", text))
    assert addresses <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xhtml"}
    assert not re.search(r"<(link|iframe|object|embed)\b|@import|url\(", text)


def test_how_it_was_made_is_said_in_words(made):
    store = Store(made / "store")
    told = _about(store)
    assert told["search"] == "joint, spatial objective"
    assert told["camera"] == "that of each frame"
    made_with = store.info["made_with"]
    made_with["options"] |= {"instances": True, "significance": 100.0, "rng": 5}
    made_with["camera"] = pw.cameras.KINECT_V1.describe()
    told = _about(store)
    assert told["search"] == "joint, spatial objective, instances, significance 100.0, seed 5"
    assert told["camera"].startswith("fx 5")


def test_colours_of_tables_are_those_of_pictures_however_many_planes_there_are(page):
    (text,) = re.findall('id="settings">(.*?)</script>', page.read_text(encoding="utf-8"))
    colours = json.loads(text)["colours"]
    drawn = ["#" + each.tobytes().hex() for each in distinct_colours(300)]
    assert [colours[index % len(colours)] for index in range(300)] == drawn  # as the script does


def test_every_brace_of_the_style_has_its_other(page):
    (style,) = re.findall("<style>(.*?)</style>", page.read_text(encoding="utf-8"), re.DOTALL)
    depth = np.cumsum([{"{": 1, "}": -1}.get(each, 0) for each in style])
    assert depth.min() == depth[-1] == 0


def test_planes_are_drawn_alone_where_the_source_is_gone(made, tmp_path):
    shutil.copytree(made / "frames", tmp_path / "frames")
    make_folder_store(tmp_path / "frames", tmp_path / "store")
    (tmp_path / "frames").rename(tmp_path / "moved")
    code, text, errors = run("view", tmp_path / "store", "-o", tmp_path / "g.html")
    assert code == 0
    assert f"the planes of {KNOWN - 1} frames are drawn without picture or depth" in errors
    assert f"there is no {tmp_path}/frames" in errors
    assert text.startswith(f"{KNOWN} frames, of which 1 failed,")
    records, pictures = records_of(tmp_path / "g.html")
    assert sum(picture is not None for picture in pictures) == KNOWN - 1
    assert all("there is no" in each["alone"] for each in records if "failed" not in each)
    arguments = ("--source", tmp_path / "moved", "--limit", 3)
    code, text, errors = run("view", tmp_path / "store", "-o", tmp_path / "g.html", *arguments)
    assert (code, errors) == (0, "")
    assert len(records_of(tmp_path / "g.html")[0]) == 3


def test_without_pictures_planes_are_drawn_over_the_depth(tmp_path):
    write_frames(tmp_path / "frames", 1, rgb=False)
    store = make_folder_store(tmp_path / "frames", tmp_path / "store")
    assert write_gallery(store, tmp_path / "g.html").alone == 0
    records, pictures = records_of(tmp_path / "g.html")
    found = {each["id"]: (each, data) for each, data in zip(records, pictures, strict=True)}
    record, picture = found["room 0"]
    assert record["over"] == "its depth"
    assert len(np.unique(np.asarray(decoded(picture)).reshape(-1, 3), axis=0)) > 100  # shaded


@pytest.mark.parametrize("far", [1e10, 3.4e38, np.inf])
def test_depth_that_a_renderer_writes_for_no_surface_is_none(tmp_path, far):
    room = scenes.room(0, size=SIZE)
    depth = (0.001 * room.depth).astype(np.float32)
    depth[:20, :20] = far
    camera = [room.camera.fx, room.camera.fy, room.camera.cx, room.camera.cy]
    (tmp_path / "frames").mkdir()
    np.savez(tmp_path / "frames" / "room.npz", depth=depth, K=camera)
    store = make_folder_store(tmp_path / "frames", tmp_path / "store")
    source = StoredSource(store)
    shown = thumbnail_of(store["room"], source)  # without a warning
    assert np.asarray(Image.open(io.BytesIO(shown.webp)))[:16, :16].max() < 10
    assert np.isnan(metres(store["room"], source[store["room"]])[:20, :20]).all()


def test_a_picture_of_another_view_is_left_out(tmp_path):
    write_frames(tmp_path / "frames", 1)
    with np.load(tmp_path / "frames" / "room 0.npz") as read:
        arrays = dict(read)
    np.savez(tmp_path / "frames" / "room 0.npz", **arrays | {"rgb": arrays["rgb"][:, ::2]})
    store = make_folder_store(tmp_path / "frames", tmp_path / "store")
    assert thumbnail_of(store["room 0"], StoredSource(store)).over == "its depth"


@pytest.mark.parametrize("parts", [".", "seq-01"])
def test_pictures_of_a_camera_beside_are_not_drawn_over(tmp_path, parts):
    dataset_files.write_seven_scenes(tmp_path / "data" / parts)
    opened = open_source(tmp_path / "data", camera=dataset_files.CAMERA)
    store = make_store(opened, tmp_path / "store")
    source = StoredSource(store)
    first = store[store.ids[0]]
    assert source[first].rgb is not None
    assert not source.registered
    assert thumbnail_of(first, source).over == "its depth"


def test_a_damaged_pose_is_nothing_to_the_page(tmp_path):
    dataset_files.write_scannet(tmp_path / "data")
    (tmp_path / "data/pose/2.txt").write_text("")
    store = make_store(open_source(tmp_path / "data"), tmp_path / "store")
    assert write_gallery(store, tmp_path / "g.html") == Shown(frames=3)


@pytest.fixture
def changed(made, tmp_path, monkeypatch):
    """Write a gallery of some frames, what it is told of each changed; its path."""

    def write(change, frames=1):
        monkeypatch.setattr(
            "planewise.gallery.page.record_of", lambda frame: change(record_of(frame))
        )
        write_gallery(Store(made / "store"), tmp_path / "g.html", selection=Selection(limit=frames))
        return tmp_path / "g.html"

    return write


def test_sweeps_of_a_lidar_are_magnified(opened, tmp_path, monkeypatch):
    store = make_store(Sweeps(), tmp_path / "store")
    monkeypatch.setattr("planewise.batch.stored_source._open", lambda *_: Sweeps())
    assert write_gallery(store, tmp_path / "g.html") == Shown(frames=1)
    records, (picture,) = records_of(tmp_path / "g.html")
    assert records[0]["over"] == "its depth"
    width, height = decoded(picture).size
    assert HEIGHT / 2 < height < 2 * HEIGHT
    assert 2 * HEIGHT < width < 8 * HEIGHT
    opened.open(tmp_path / "g.html")
    opened.value("document.querySelector('.card button').click()")
    assert opened.complaints() == []
    assert len(names(opened)) == 1


def test_a_curve_may_have_gaps(opened, changed):
    def with_gaps(record):
        record["curve"][{"room 0": 0, "room 1": 1}.get(record["id"], -1)] = None
        return record

    opened.open(changed(with_gaps, frames=None))
    opened.value("document.querySelectorAll('.card button').forEach((each) => each.click())")
    assert opened.complaints() == []
    assert "NaN" not in opened.value("document.getElementById('frames').outerHTML")
    assert len(names(opened)) == KNOWN


@pytest.mark.parametrize(
    ("curve", "unit", "levels"),
    [
        (
            [19_000.0, 15_500.0, 15_000.0],
            "nats",
            ["15,000", "16,000", "17,000", "18,000", "19,000"],
        ),
        ([1.25e6, 1.19e6, 1.1e6], "thousand nats", ["1,100", "1,150", "1,200", "1,250"]),
        (
            [19e6, 12e6, 8e6],
            "thousand nats",
            ["8,000", "10,000", "12,000", "14,000", "16,000", "18,000"],
        ),
        ([2.4e9, 2.396e9, 2.3951e9], "million nats", ["2,396", "2,397", "2,398", "2,399", "2,400"]),
        ([20.4e6, 20.1e6, 20e6], "million nats", ["20.0", "20.1", "20.2", "20.3", "20.4"]),
        ([98_765_432.1], "million nats", ["98.8"]),
    ],
)
def test_numbers_of_curves_are_seen_whole(opened, changed, curve, unit, levels):
    opened.open(changed(lambda record: record | {"curve": curve}))
    opened.value("document.querySelector('.card button').click()")
    texts = opened.value(
        "[...document.querySelectorAll('.curve text')].map((each) => "
        "[each.textContent, each.getBBox().x, each.getBBox().x + each.getBBox().width])"
    )
    assert [text for text, _, _ in texts][: len(levels)] == levels
    assert unit in [text for text, _, _ in texts]
    assert min(left for _, left, _ in texts) >= 0
    assert max(right for _, _, right in texts) <= 400


def test_captions_of_tables_are_seen_whole(opened, changed):
    name = 18 * "averylongname" + "\u202e"  # what follows would run to the left
    gallery = changed(lambda record: record | {"id": name})
    for width in (1280, 390):
        opened.look(width=width)
        opened.open(gallery)
        opened.value("document.querySelector('.card button').click()")
        table, seen = opened.value(
            "((e) => [e.scrollWidth, e.clientWidth])(document.querySelector('.scroll'))"
        )
        assert width == 390 or table == seen  # a name makes no table wide
        assert opened.value("document.querySelector('caption bdi').textContent") == name
        opened.value("document.querySelector('.scroll').scrollLeft = 99")
        left, right = opened.value(
            "((e) => [e.left, e.right])("
            "document.querySelector('caption span').getBoundingClientRect())"
        )
        assert 0 <= left < right <= width


def test_names_are_found_however_their_letters_are_written(opened, changed):
    """As macOS names files: a letter, and what stands above it."""
    opened.open(changed(lambda record: record | {"id": "Ku\u0308che"}))
    for typed in ("k\u00fc", "KU\u0308"):
        opened.value(
            f"((e) => {{ e.value = {typed!r}; e.dispatchEvent(new Event('input', "
            "{ bubbles: true })); })(document.getElementById('name'))"
        )
        assert len(names(opened)) == 1


def test_small_planes_of_exact_sensors_have_a_size(opened, changed):
    planes = [[0, 0, -1, 0.5, -900, 400, 2.1234e-5, 3.0468e-4], [*[1] * 6, 0.1, 104]]
    opened.open(changed(lambda record: record | {"planes": planes}))
    opened.value("document.querySelector('.card button').click()")
    sizes = opened.value(
        "[...document.querySelectorAll('tbody tr')].map((row) => "
        "[...row.children].slice(-2).map((each) => each.textContent))"
    )
    assert sizes == [["0.0212 mm", "0.000305 m²"], ["100 mm", "104 m²"]]


def test_frames_that_changed_or_are_damaged_say_so(made, tmp_path):
    shutil.copytree(made / "frames", tmp_path / "frames")
    store = make_folder_store(tmp_path / "frames", tmp_path / "store")
    shutil.copy(tmp_path / "frames" / "room 0.npz", tmp_path / "frames" / "room 1.npz")
    store.label_file("room 2").write_bytes(b"none")
    shown = write_gallery(store, tmp_path / "g.html")
    why, (unreadable,) = shown.reason, shown.damaged
    assert shown == Shown(frames=KNOWN, failed=1, alone=1, reason=why, damaged=[unreadable])
    records, pictures = records_of(tmp_path / "g.html")
    found = {each["id"]: (each, data) for each, data in zip(records, pictures, strict=True)}
    changed, picture = found["room 1"]
    assert "no longer those of the store" in changed["alone"]
    assert picture is not None
    damaged, picture = found["room 2"]
    assert "room 2" in damaged["alone"] == unreadable
    assert picture is None


def test_the_page_is_there_whole_or_not_at_all(made, tmp_path):
    def stop(done):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_gallery(Store(made / "store"), tmp_path / "g.html", report=stop)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(PlanewiseError, match="is a folder"):
        write_gallery(Store(made / "store"), tmp_path)
    with pytest.raises(PlanewiseError, match="there is no folder"):
        write_gallery(Store(made / "store"), tmp_path / "none" / "g.html")


@pytest.mark.parametrize("name", ["store.json", "labels/room 0.png", "labels/page.html"])
def test_the_page_is_no_file_of_the_store(made, name):
    store = Store(made / "store")
    files = {path: path.read_bytes() for path in store.path.rglob("*") if path.is_file()}
    code, text, errors = run("view", store.path, "-o", store.path / name)
    assert (code, text) == (2, "")
    assert errors.startswith("error: output: ")
    assert files == {path: path.read_bytes() for path in store.path.rglob("*") if path.is_file()}


def test_some_of_the_frames(made, tmp_path):
    shown = write_gallery(
        Store(made / "store"), tmp_path / "g.html", selection=Selection(every=3, limit=2)
    )
    assert shown.frames == 2
    assert sorted(each["number"] for each in records_of(tmp_path / "g.html")[0]) == [0, 3]


def test_small_pictures_of_large_frames():
    room = scenes.room(1, size=SIZE)
    labels = room.labels.astype(np.uint16)
    half = SIZE[0] // 2
    over_picture = draw_small(labels, half, depth=room.depth, camera=room.camera, rgb=room.rgb)
    metres = np.where(room.depth > 0, room.depth, np.nan)
    over_depth = draw_small(labels, half, depth=metres, camera=room.camera)
    alone = draw_small(labels, SIZE[0])
    for each in (over_picture, over_depth):
        assert each.shape == (half, SIZE[1] // 2, 3)
        assert each.dtype == np.uint8
    assert alone.shape == (*SIZE, 3)
    colours = [np.median(alone[labels == label], axis=0) for label in (1, 2)]
    assert np.abs(colours[0] - colours[1]).max() > 30


# In a browser


def names(tab):
    return tab.value("[...document.querySelectorAll('.card h3')].map((each) => each.textContent)")


def count(tab):
    return tab.value("document.getElementById('count').textContent")


def test_the_page_opens_without_a_complaint(opened, page):
    opened.look()
    opened.open(page)
    assert opened.complaints() == []
    assert opened.value("document.title") == "Planes of frames"  # no hostile name ran
    assert len(names(opened)) == KNOWN
    assert opened.value("document.querySelectorAll('script, img:not(.card img)').length") == 4
    assert opened.value("[...document.images].every((each) => each.alt && each.naturalWidth)")
    assert count(opened) == f"{KNOWN} frames."
    assert "1 failed" in opened.value("document.getElementById('totals').textContent")
    failed = opened.value("document.querySelector('.failed:not(noscript *)').textContent")
    assert failed.startswith("✗ Failed: depth: broken.npz cannot be read")


def test_sorting_and_filtering_by_keyboard(opened, made, page):
    opened.look()
    opened.open(page)
    of_planes = {each.id: len(each.planes) for each in Store(made / "store")}
    opened.tab_to("e.id === 'sort'")
    opened.type("num")  # the choice that begins so
    opened.tab_to("e.id === 'direction'")
    opened.press("Enter")
    assert opened.value("document.getElementById('direction').ariaPressed") == "true"
    found = [of_planes.get(each, -1) for each in names(opened)]
    assert found == sorted(found, reverse=True)
    opened.tab_to("e.id === 'fewest'")
    most = max(of_planes.values())
    opened.type(str(most))
    wanted = {each for each, planes in of_planes.items() if planes >= most}
    assert set(names(opened)) == wanted
    assert count(opened) == f"{len(wanted)} of {KNOWN} frames."
    assert opened.value("document.getElementById('count').ariaLive") == "polite"
    opened.tab_to("e.type === 'reset'")
    opened.press("Enter")
    opened.value("new Promise((done) => setTimeout(done, 50))")
    assert len(names(opened)) == KNOWN
    opened.tab_to("e.id === 'status'")
    opened.type("fail")
    assert names(opened) == ["broken"]
    opened.press("ArrowUp")
    assert set(names(opened)) == {each for each, planes in of_planes.items() if not planes}
    assert opened.complaints() == []


def test_failures_are_first_whatever_the_direction(opened, page):
    opened.look()
    opened.open(page)
    opened.tab_to("e.id === 'direction'")
    opened.press("Enter")
    opened.tab_to("e.id === 'sort'")
    opened.type("fail")
    assert names(opened)[0] == "broken"
    assert opened.value("document.getElementById('direction').disabled")
    opened.press("Home")
    assert not opened.value("document.getElementById('direction').disabled")
    assert names(opened)[0] != "broken"  # the largest number is another's


def test_details_open_by_keyboard_and_are_named(opened, made, page):
    opened.look()
    opened.open(page)
    opened.tab_to("e.textContent === 'Details of room 0'")
    seen = opened.value("getComputedStyle(document.activeElement).outlineStyle")
    assert seen == "solid"  # the focus can be seen
    opened.press("Enter")
    assert opened.value("document.activeElement.ariaExpanded") == "true"
    frame = Store(made / "store")["room 0"]
    shown = opened.value(
        "[...document.querySelectorAll('.open tbody tr')].map((row) => "
        "[row.firstChild.scope, ...[...row.children].map((each) => each.textContent)])"
    )
    assert len(shown) == len(frame.planes)
    first = frame.plane_table.to_pylist()[0]
    assert shown[0][:4] == ["row", "1", f"{first['information']:,.0f}", f"{first['readings']:,}"]
    assert shown[0][5:9] == [f"{first[f'normal_{axis}']:.3f}" for axis in "xyz"] + [
        f"{first['distance']:.3f} m"
    ]
    heads = opened.value("[...document.querySelectorAll('.open thead th')].map((e) => e.scope)")
    assert heads == ["col"] * 10
    label = opened.value("document.querySelector('.open svg.curve').getAttribute('aria-label')")
    assert f"{frame.row['curve'][0]:,.0f} nats with none" in label
    opened.press("Enter")
    assert opened.value("document.querySelectorAll('.open').length") == 0


def test_details_leave_no_room_empty_and_curves_have_a_scale(opened, page):
    opened.look()
    opened.open(page)
    tops = "[...document.querySelectorAll('.card')].map((each) => each.getBoundingClientRect().top)"
    columns = opened.value(tops).count(opened.value(tops)[0])
    assert columns > 2
    opened.value("document.querySelectorAll('.card button').forEach((each) => each.click())")
    levels = opened.value(
        "[...document.querySelectorAll('svg.curve:has(.dot + .dot)')]"
        ".map((each) => each.querySelectorAll('.grid').length)"
    )
    assert len(levels) > 3
    assert min(levels) >= 3
    opened.open(page)
    opened.value("document.querySelectorAll('.card button')[1].click()")
    assert opened.value(tops).count(opened.value(tops)[0]) == columns


@pytest.mark.parametrize(("width", "dark"), [(1280, False), (1280, True), (360, False)])
def test_it_fits_screens_and_eyes(opened, page, width, dark):
    opened.look(width=width, height=900, dark=dark)
    opened.open(page)
    opened.value("document.querySelectorAll('.card button').forEach((each) => each.click())")
    assert opened.value("document.documentElement.scrollWidth") <= width  # nothing sticks out
    contrasts = opened.value(_CONTRASTS)
    assert len(contrasts) > 40
    assert min(contrasts.values()) >= 4.5, contrasts  # WCAG 2, level AA
    with Image.open(io.BytesIO(opened.screenshot())) as image:
        corner = np.asarray(image.convert("L"))[2, 2]
    assert (corner < 60) == dark


def test_print_has_no_writing_larger_than_its_text_but_headings(opened, page):
    opened.look(media="print")
    opened.open(page)
    opened.value("document.querySelectorAll('.card button').forEach((each) => each.click())")
    text, *others = opened.value(
        "[document.body, ...document.querySelectorAll('h3, .text, caption, td')]"
        ".map((each) => parseFloat(getComputedStyle(each).fontSize))"
    )
    assert text == pytest.approx(9 * 96 / 72)
    assert max(others) <= text


_CONTRASTS = """(() => {
  const light = (colour) => {
    const part = colour.match(/[\\d.]+/g).slice(0, 3).map((each) => each / 255)
      .map((each) => each <= 0.03928 ? each / 12.92 : ((each + 0.055) / 1.055) ** 2.4);
    return 0.2126 * part[0] + 0.7152 * part[1] + 0.0722 * part[2];
  };
  const behind = (node) => {
    const colour = getComputedStyle(node).backgroundColor;
    return colour === "rgba(0, 0, 0, 0)" ? behind(node.parentElement) : colour;
  };
  const found = {};
  for (const node of document.querySelectorAll("body *")) {
    const direct = [...node.childNodes].some((each) => each.nodeType === 3 && each.data.trim());
    if (!direct || !node.checkVisibility() || node.disabled) continue;
    if (node.closest("script, noscript")) continue;
    const style = getComputedStyle(node);
    const [a, b] = [light(node.closest("svg") ? style.fill : style.color), light(behind(node))];
    found[`${node.tagName} ${node.textContent.slice(0, 30)}`] =
      (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  }
  return found;
})()"""


def test_two_thousand_frames_open_fast(opened, made, tmp_path, monkeypatch):
    source = Many(made / "frames", MANY)
    store = make_store(source, tmp_path / "store", labels="rle", engine=Cloning(KNOWN))
    room = scenes.room(1, size=(240, 320))
    labels = room.labels.astype(np.uint16)
    picture = io.BytesIO()
    Image.fromarray(draw_small(labels, HEIGHT, depth=room.depth, rgb=room.rgb)).save(
        picture, "WEBP", quality=70
    )
    large = Thumbnail(webp=picture.getvalue(), over="its picture")  # of the size of those of VGA
    monkeypatch.setattr("planewise.gallery.page.thumbnail_of", lambda *_: large)
    shown = write_gallery(store, tmp_path / "g.html")
    assert shown.frames == MANY
    assert (tmp_path / "g.html").stat().st_size > 10e6
    opened.look()
    seconds = opened.open(tmp_path / "g.html")
    assert seconds < 5  # some 0.3 s on an idle machine
    assert opened.complaints() == []
    assert count(opened) == "2,000 frames; these are 1 to 48."
    opened.tab_to("e.textContent === 'Next'")
    for _ in range(3):
        opened.press("Enter")
    assert count(opened) == "2,000 frames; these are 145 to 192."
    assert len(names(opened)) == 48
    opened.value("Promise.all([...document.images].map((each) => each.decode()))")
    for _ in range(MANY // 48 - 3):
        opened.press("Enter")
    assert count(opened) == "2,000 frames; these are 1,969 to 2,000."
    assert opened.value("document.activeElement.id") == "results"  # there is no next page
    opened.tab_to("e.id === 'name'")
    start = opened.value("performance.now()")
    opened.type("0199")
    assert names(opened) == ["00199", *(f"0199{digit}" for digit in range(10))]
    assert opened.value("performance.now()") - start < 3000


def test_thumbnails_do_not_change_the_store(made):
    store = Store(made / "store")
    before = {path: path.stat().st_mtime_ns for path in Path(store.path).rglob("*")}
    thumbnail_of(store["room 0"], StoredSource(store))
    assert before == {path: path.stat().st_mtime_ns for path in Path(store.path).rglob("*")}
