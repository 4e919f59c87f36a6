import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from planewise import scenes
from planewise.information import mask_information
from planewise.spatial.mask_code import MaskCounts, spatial_mask_information

from .arithmetic_coder import decode, encode, length


def check(labels, there, planes, slack):
    bits = encode(labels, there, planes)
    assert_array_equal(decode(bits, there, planes), np.where(there, labels, 0))
    nats = spatial_mask_information(labels, there, planes)
    assert len(bits) * math.log(2) == pytest.approx(nats, rel=0.01, abs=slack)


@pytest.mark.parametrize("seed", range(2))
def test_a_room_is_sent_and_received_at_the_claimed_length(seed):
    scene = scenes.room(seed, size=(90, 120))
    check(scene.labels.astype(int), scene.depth > 0, len(scene.planes), 2)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10**6),
    height=st.integers(1, 12),
    width=st.integers(1, 12),
    planes=st.integers(0, 6),
    share=st.floats(0, 1),
)
def test_any_mask_is_sent_and_received(seed, height, width, planes, share):
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, planes + 1, (height, width))
    check(labels, rng.random((height, width)) < share, planes, 2)


def check_prefixes(labels, there, planes, rng):
    """All lengths of one pass are those of the plain code, planes taken away one by one."""
    labels = np.where(there, labels, 0).astype(np.uint16)
    place = np.append(0, 1 + rng.permutation(planes)).astype(np.uint16)
    readings = np.bincount(labels[there], minlength=planes + 1)
    lengths = MaskCounts.of(labels, there.astype(np.float32)).lengths(readings, place)
    for n in range(planes + 1):
        kept = np.where(place[labels] <= n, place[labels], 0)
        assert lengths[n] == pytest.approx(length(kept, there, n), rel=1e-9, abs=1e-9)
        assert spatial_mask_information(place[labels], there, n) == pytest.approx(lengths[n])


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10**6),
    height=st.integers(1, 12),
    width=st.integers(1, 24),
    planes=st.integers(0, 6),
    share=st.floats(0, 1),
    size=st.integers(1, 5),
)
def test_all_shorter_lists_of_planes_in_one_pass(seed, height, width, planes, share, size):
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, planes + 1, (height, width)).repeat(size, 0).repeat(size, 1)
    check_prefixes(labels, rng.random(labels.shape) < share, planes, rng)


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), planes=st.integers(1, 6), size=st.integers(1, 5))
def test_labels_that_become_one_need_no_second_count(seed, planes, size):
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, planes + 1, (9, 14)).repeat(size, 0).repeat(size, 1).astype(np.uint16)
    there = (rng.random(labels.shape) < 0.9).astype(np.float32)
    place = np.append(0, rng.integers(1, planes + 1, planes)).astype(np.uint16)
    order = np.append(0, 1 + rng.permutation(planes)).astype(np.uint16)
    readings = np.bincount(place[labels][there > 0], minlength=planes + 1)
    again = MaskCounts.of(place[labels], there).lengths(readings, order)
    counts = MaskCounts.of(labels, there).renamed(place)
    assert_array_equal(counts.lengths(readings, order), again)


def test_all_shorter_lists_of_planes_of_a_room():
    scene = scenes.room(2, size=(90, 120))
    check_prefixes(scene.labels, scene.depth > 0, len(scene.planes), np.random.default_rng(0))


def test_without_planes_there_is_nothing_to_say():
    assert spatial_mask_information(np.zeros((9, 9), int), np.ones((9, 9), bool), 0) == 0


def test_surfaces_are_cheap_and_white_noise_is_no_cheaper_than_uniform():
    rng = np.random.default_rng(0)
    there = np.ones((200, 200), bool)
    noise = rng.integers(0, 5, (200, 200))
    uniform = mask_information(noise.size, 4)
    assert uniform < spatial_mask_information(noise, there, 4) < 1.02 * uniform
    scene = scenes.room(1)
    planes = len(scene.planes)
    spatial = spatial_mask_information(scene.labels.astype(int), scene.depth > 0, planes)
    assert spatial < 0.03 * mask_information(scene.labels.size, planes)


def test_the_largest_labels():
    there = np.ones((9, 9), bool)
    low, high = np.ones((9, 9), int), np.full((9, 9), 65_534)
    assert spatial_mask_information(high, there, 65_534) == pytest.approx(
        spatial_mask_information(low, there, 65_534)
    )
    with pytest.raises(ValueError, match="fewer than 65535 are told apart"):
        spatial_mask_information(high, there, 65_535)
