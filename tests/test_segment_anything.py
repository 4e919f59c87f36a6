"""Segment Anything, with tiny networks of random weights: `make test-sam`."""

from __future__ import annotations

import json

import numpy as np
import pytest

import planewise as pw
from planewise.partition import SegmentAnything, View

torch = pytest.importorskip("torch", reason="the extra 'sam' is not installed")
transformers = pytest.importorskip("transformers", reason="the extra 'sam' is not installed")

SIDE = 64  # pixels of what the networks look at
SHAPE = (30, 48)

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
]


@pytest.fixture(scope="module")
def sam(tmp_path_factory):
    """Folder of a tiny SAM, as `transformers` writes it."""
    from transformers.models.sam.image_processing_pil_sam import SamImageProcessorPil

    folder = tmp_path_factory.mktemp("sam")
    torch.manual_seed(0)
    vision = {
        "hidden_size": 16,
        "output_channels": 16,
        "num_hidden_layers": 2,
        "num_attention_heads": 2,
        "image_size": SIDE,
        "patch_size": 16,
        "window_size": 2,
        "global_attn_indexes": [1],
        "mlp_dim": 32,
        "num_pos_feats": 8,
    }
    prompt = {"hidden_size": 16, "image_size": SIDE, "patch_size": 16, "mask_input_channels": 4}
    decoder = {
        "hidden_size": 16,
        "mlp_dim": 32,
        "num_attention_heads": 2,
        "iou_head_hidden_dim": 16,
        "num_hidden_layers": 2,
    }
    config = transformers.SamConfig(
        vision_config=vision, prompt_encoder_config=prompt, mask_decoder_config=decoder
    )
    transformers.SamModel(config).save_pretrained(folder)
    processor = SamImageProcessorPil(
        size={"longest_edge": SIDE},
        pad_size={"height": SIDE, "width": SIDE},
        mask_size={"longest_edge": 16},
        mask_pad_size={"height": 16, "width": 16},
    )
    transformers.SamProcessor(processor).save_pretrained(folder)
    return folder


@pytest.fixture(scope="module")
def sam2(tmp_path_factory):
    """Folder of a tiny SAM 2; its processor's file is as the hub has it."""
    folder = tmp_path_factory.mktemp("sam2")
    torch.manual_seed(0)
    backbone = {
        "hidden_size": 8,
        "num_attention_heads": 1,
        "image_size": [SIDE, SIDE],
        "blocks_per_stage": [1, 1, 2, 1],
        "embed_dim_per_stage": [8, 16, 32, 64],
        "num_attention_heads_per_stage": [1, 1, 2, 2],
        "window_size_per_stage": [4, 4, 4, 2],
        "global_attention_blocks": [3],
        "window_positional_embedding_background_size": [4, 4],
        "model_type": "sam2_hiera_det_model",
    }
    vision = {
        "backbone_config": backbone,
        "backbone_channel_list": [64, 32, 16, 8],
        "backbone_feature_sizes": [[16, 16], [8, 8], [4, 4]],
        "fpn_hidden_size": 32,
    }
    prompt = {"hidden_size": 32, "image_size": SIDE, "patch_size": 16, "mask_input_channels": 4}
    decoder = {
        "hidden_size": 32,
        "mlp_dim": 32,
        "num_attention_heads": 2,
        "iou_head_hidden_dim": 16,
        "num_hidden_layers": 2,
    }
    config = transformers.Sam2Config(
        vision_config=vision, prompt_encoder_config=prompt, mask_decoder_config=decoder
    )
    transformers.Sam2Model(config).save_pretrained(folder)
    processor = {
        "image_processor_type": "Sam2ImageProcessorFast",
        "size": {"height": SIDE, "width": SIDE},
        "image_mean": [0.485, 0.456, 0.406],
        "image_std": [0.229, 0.224, 0.225],
        "rescale_factor": 1 / 255,
        "mask_size": {"height": 16, "width": 16},
    }
    (folder / "preprocessor_config.json").write_text(json.dumps(processor))
    return folder


@pytest.fixture
def view():
    rng = np.random.default_rng(0)
    rgb = np.zeros((*SHAPE, 3), np.uint8)
    rgb[5:20, 8:30] = (200, 60, 30)
    rgb[12:, 30:] = (20, 180, 220)
    rgb += rng.integers(0, 20, rgb.shape, np.uint8)
    return View(
        depth=np.full(SHAPE, 2.0), camera=pw.PinholeCamera(fx=40, fy=40, cx=24, cy=15), rgb=rgb
    )


def generous(folder, **options):
    """Random weights trust nothing: everything passes."""
    return SegmentAnything(
        **{"model": str(folder), "stability": 0.0, "quality": 0.0, "points": 4, "repeated": 1.0}
        | options
    )


@pytest.mark.parametrize("kind", ["sam", "sam2"])
def test_masks_are_those_of_the_network(kind, view, request):
    """Points one by one, with the picture itself in place of its embedding."""
    folder = request.getfixturevalue(kind)
    masks = generous(folder, batch=5)(view)
    assert masks.dtype == bool
    assert masks.shape[1:] == SHAPE
    assert masks.any(axis=(1, 2)).all()

    net = transformers.AutoModelForMaskGeneration.from_pretrained(folder).eval()
    height, width = (40, 64) if kind == "sam" else (64, 64)
    from PIL import Image

    small = Image.fromarray(view.rgb).resize((width, height), Image.Resampling.BILINEAR)
    value = (np.asarray(small) / 255 - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]
    picture = np.zeros((1, 3, SIDE, SIDE), np.float32)
    picture[0, :, :height, :width] = np.moveaxis(value, -1, 0)
    wanted = []
    for i in range(4):
        for j in range(4):
            point = torch.tensor([[[[(j + 0.5) / 4 * width, (i + 0.5) / 4 * height]]]])
            with torch.inference_mode():
                out = net(pixel_values=torch.from_numpy(picture), input_points=point.float())
                level = out.pred_masks[0]
                if kind == "sam":  # which has filled the picture up to a square
                    level = torch.nn.functional.interpolate(level, (SIDE, SIDE), mode="bilinear")
                    level = level[..., :height, :width]
                level = torch.nn.functional.interpolate(level, SHAPE, mode="bilinear")[0]
            trusted = out.iou_scores[0, 0].numpy() >= 0
            wanted += [each for each in level.numpy()[trusted] > 0 if each.any()]
    # In any order; rounding may move pixels that lie at the cut.
    assert len(masks) == len(wanted)
    for mask in masks:
        assert min(np.count_nonzero(mask ^ other) for other in wanted) <= 2


@pytest.mark.parametrize("kind", ["sam", "sam2"])
def test_only_stable_and_trusted_masks_are_left(kind, view, request):
    folder = request.getfixturevalue(kind)
    everything = len(generous(folder)(view))
    assert everything > 0
    assert len(generous(folder, stability=1.0)(view)) < everything
    assert len(generous(folder, quality=1.0)(view)) == 0
    assert 0 < len(generous(folder, repeated=0.5)(view)) < everything


@pytest.mark.parametrize("kind", ["sam", "sam2"])
@pytest.mark.parametrize("search", ["joint", "sequential"])
def test_detection_with_its_regions(kind, search, view, request):
    folder = request.getfixturevalue(kind)
    rng = np.random.default_rng(1)
    depth = 2.0 + rng.normal(0, 0.004, SHAPE)
    detector = pw.Detector(
        view.camera, pw.Sensor(noise=0.004), search=search, partition=generous(folder)
    )
    model = detector(depth, rgb=view.rgb)
    assert len(model) >= 1
    assert model.settings["partition"].startswith("Segment Anything (sam")
    assert np.array_equal(detector(depth, rgb=view.rgb).labels, model.labels)


def test_a_model_of_another_kind_is_refused(tmp_path, view):
    transformers.BertConfig().save_pretrained(tmp_path)
    with pytest.raises(ValueError, match="a model of kind bert; expected SAM or SAM 2"):
        generous(tmp_path)(view)


def test_what_cannot_be_loaded_is_said_in_one_line(tmp_path, sam, view):
    (tmp_path / "empty").mkdir()
    for name, why in (("nowhere", "there is no folder .*nowhere"), ("empty", ".*empty cannot be")):
        with pytest.raises(ValueError, match=f"sam: {why}") as error:
            generous(tmp_path / name)(view)
        assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match="cannot be used on abacus"):
        generous(sam, device="abacus")(view)
