from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from planewise.errors import PlanewiseError
from planewise.files.coco_rle import decode_mask, encode_labels

images = hnp.arrays(
    np.uint16,
    hnp.array_shapes(min_dims=2, max_dims=2, max_side=40),
    elements=st.integers(0, 3),
    fill=st.just(0),
)


@given(images)
def test_decoding_gives_the_masks_back(labels):
    texts = encode_labels(labels, 3)
    for label, text in enumerate(texts, start=1):
        assert np.array_equal(decode_mask(text, labels.shape), labels == label)


@given(images)
def test_the_texts_are_those_of_the_coco_tools(labels):
    from pycocotools import mask

    for label, text in enumerate(encode_labels(labels, 3), start=1):
        theirs = mask.encode(np.asfortranarray((labels == label).astype(np.uint8)))
        assert theirs["counts"].decode("ascii") == text


def test_long_runs_take_several_groups_of_bits():
    labels = np.zeros((700, 900), np.uint16)
    labels[100:600, 200:850] = 1
    (text,) = encode_labels(labels, 1)
    assert np.array_equal(decode_mask(text, labels.shape), labels == 1)


@pytest.mark.parametrize(
    "text", ["", "1", "P" * 40, "P" * 13 + "1", ":K?", "é0", "12346", ("o" * 11 + "?") * 40]
)
def test_damaged_texts_are_refused(text):
    with pytest.raises(PlanewiseError, match="run lengths"):
        decode_mask(text, (4, 5))
