"""Sensors as JSON files."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import planewise as pw
from planewise import noise, sensors
from planewise.errors import PlanewiseError

Z = np.linspace(0.3, 9, 30)


@pytest.mark.parametrize("name", sensors.PRESETS)
def test_presets_survive_a_file(tmp_path, name):
    sensor = replace(sensors.PRESETS[name], depth_range=4.0)
    sensors.save(sensor, tmp_path / "sensor.json")
    assert sensors.load(tmp_path / "sensor.json") == sensor
    assert [path.name for path in tmp_path.iterdir()] == ["sensor.json"]


def test_files_from_before_there_were_bounds(tmp_path):
    path = tmp_path / "sensor.json"
    sensors.save(sensors.KINECT_V1, path)
    record = json.loads(path.read_text())
    assert record["parts"].pop("bounds") is True
    path.write_text(json.dumps(record))
    assert sensors.load(path) == sensors.KINECT_V1


def test_estimates_survive_a_file(tmp_path):
    scene = pw.scenes.corner(size=(240, 320))
    found = pw.estimate_noise(scene.depth, scene.camera, scene.sensor)
    sensor = found.sensor(scene.sensor)
    path = tmp_path / "sensor.json"
    sensors.save(sensor, path, calibration={"frames": 1})
    again = sensors.load(path)
    assert_allclose(again.sigma(Z), sensor.sigma(Z), rtol=1e-15)
    assert again == sensor
    assert again.parts.shared is noise.NOTHING
    assert json.loads(path.read_text())["calibration"] == {"frames": 1}


def test_sums_are_written_term_by_term(tmp_path):
    parts = noise.RootSum((noise.constant(0.003), noise.RootSum((noise.KINECT,))))
    sensors.save(pw.Sensor(noise=parts), tmp_path / "s.json")
    record = json.loads((tmp_path / "s.json").read_text())
    assert [sorted(term) for term in record["noise"]] == [
        ["constant_m", "linear_m_per_m", "offset_m", "quadratic_m_per_m2"]
    ] * 2
    assert_allclose(sensors.load(tmp_path / "s.json").sigma(Z), parts(Z))


def test_what_is_no_sensor_is_not_written(tmp_path):
    with pytest.raises(ValueError, match=r"sensor must be a planewise\.Sensor, .* got int"):
        sensors.save(3, tmp_path / "sensor.json")


def test_only_curves_can_be_written(tmp_path):
    for bad, message in ((lambda z: z, "only noise made of"), ("auto", "not known yet")):
        with pytest.raises(ValueError, match=message):
            sensors.save(pw.Sensor(noise=bad), tmp_path / "s.json")
    assert not list(tmp_path.iterdir())


TERM = dict.fromkeys(("constant_m", "linear_m_per_m", "quadratic_m_per_m2", "offset_m"), 0.0)
BAD_FILES = {
    "no json": ("{", "not valid JSON"),
    "a list": ("[1]", "does not describe a sensor"),
    "another schema": ({"schema": "planewise/planes"}, "does not describe a sensor"),
    "a later version": ({"schema_version": 2}, "schema version 2, this program reads 1"),
    "no depth": ({"max_depth_m": None}, "max_depth_m must be a finite number, got None"),
    "text": ({"resolution_m": "1 mm"}, "resolution_m must be a finite number, got '1 mm'"),
    "true": ({"min_depth_m": True}, "min_depth_m must be a finite number, got True"),
    "negative depth": ({"max_depth_m": -1}, "max_depth must be a positive"),
    "no noise": ({"noise": None}, "noise must be a list of terms with constant_m"),
    "empty noise": ({"noise": []}, "noise must have at least one term"),
    "half a term": ({"noise": [{"constant_m": 1}]}, "noise.linear_m_per_m must be a finite number"),
    "huge depth": ({"max_depth_m": 10**400}, "max_depth_m must be a finite number, got inf"),
    "huge noise": (
        {"noise": [TERM | {"constant_m": 10**400}]},
        "noise.constant_m must be a finite number, got inf",
    ),
    "negative noise": (
        {"noise": [TERM | {"constant_m": -0.1}]},
        "sensor.json: noise: sigma must be positive",
    ),
    "negative part": (
        {"parts": {"white": [TERM | {"constant_m": -0.1}], "shared": [], "drift_per_100_px": []}},
        "sensor.json: parts.white: sigma must be positive",
    ),
    "parts that are none": ({"parts": 3}, "parts must be null, or hold white"),
    "bounds that are a word": (
        {
            "parts": {
                "white": [TERM | {"constant_m": 0.1}], "shared": [], "drift_per_100_px": [],
                "bounds": "no",
            }
        },
        "sensor.json: parts.bounds must be True or False, got 'no'",
    ),
    "parts without white": (
        {"parts": {"white": [], "shared": [], "drift_per_100_px": []}},
        "parts.white must have",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_are_refused(tmp_path, name):
    change, message = BAD_FILES[name]
    path = tmp_path / "sensor.json"
    sensors.save(sensors.KINECT_V1, path)
    if isinstance(change, str):
        path.write_text(change)
    else:
        path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(PlanewiseError, match=r"^sensor: sensor.json: ") as error:
        sensors.load(path)
    assert message in str(error.value)


def test_integers_that_python_does_not_read_are_refused(tmp_path):
    path = tmp_path / "sensor.json"
    sensors.save(sensors.KINECT_V1, path)
    huge = json.dumps(json.loads(path.read_text()) | {"max_depth_m": "huge"})
    path.write_text(huge.replace('"huge"', "9" * 5000))
    with pytest.raises(PlanewiseError, match="max_depth_m must be a finite number, got inf"):
        sensors.load(path)


def test_noise_that_no_float_holds_is_refused():
    for make in (noise.constant, lambda sigma: pw.Sensor(noise=sigma)):
        with pytest.raises(ValueError, match="noise: sigma must be positive and a number"):
            make(10**400)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ValueError, match="there is no file"):
        sensors.load(tmp_path / "none.json")
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="not valid JSON"):
        sensors.load(tmp_path / "binary.json")
    (tmp_path / "huge.json").write_bytes(b" " * 1_000_001)
    with pytest.raises(ValueError, match="too large"):
        sensors.load(tmp_path / "huge.json")
