import numpy as np
import pytest

from facewright.apps.region_pictures import draw_regions, region_colours, region_of_faces
from facewright.apps.segment_regions import SegmentOptions, segment_performers
from facewright.errors import FacewrightError
from facewright.models.performer_data import PerformerClip, PerformerData
from facewright.models.region_boundaries import share_boundaries


def performer(rng, name="M1", fps=60.0, frames=240, shift=0.0, labels_out=None) -> PerformerData:
    """A flat patch of 12 x 9 vertices in nine blocks, each moving by itself; still in a second clip."""
    y, x = np.mgrid[0:9, 0:12]
    rest = np.stack([(x.ravel() - 5.5) * 10.0, -y.ravel() * 10.0, 0.0 * x.ravel()], axis=1) + shift
    i = (y[:-1, :-1] * 12 + x[:-1, :-1]).ravel()
    faces = np.concatenate([np.stack([i, i + 12, i + 1], 1), np.stack([i + 1, i + 12, i + 13], 1)]).astype(np.int32)
    blocks = (y.ravel() // 3) * 3 + x.ravel() // 4
    motion = rng.normal(size=(frames, 9, 3))[:, blocks] + 0.1 * rng.normal(size=(frames, 108, 3))
    still = np.zeros((60, 108, 3))
    clips = [
        PerformerClip(
            label,
            np.arange(len(moves)) / fps,
            (rest + moves).astype(np.float32),
            np.repeat(np.eye(3)[None], len(moves), 0),
            np.zeros((len(moves), 3)),
        )
        for label, moves in (("moving", motion), ("still", still))
    ]
    neutral = rest.astype(np.float32)
    return PerformerData(
        name, faces, neutral, neutral - np.float32(shift), tuple(clips), "patch", np.arange(108, dtype=np.int32)
    )


def test_blocks_are_found_at_the_paper_s_rate(rng):
    result = segment_performers([performer(rng)], ["moving"], SegmentOptions(n_regions=9))
    assert result.n_frames == 60  # 240 frames at 60 Hz, thinned to 15
    assert len(result.regions.members) == 9 and result.segmentation.chosen.compact
    assert result.pieces.tolist() == [1] * 9
    assert result.symmetry == pytest.approx(1.0)  # the blocks lie symmetric about x = 0
    assert result.remarks == ()


def test_people_of_different_size_are_taken_from_their_neutrals(rng):
    one, two = performer(rng), performer(rng, "F1", shift=40.0)
    alone = segment_performers([one], ["moving"], SegmentOptions(n_regions=9))
    both = segment_performers([one, two], ["moving"], SegmentOptions(n_regions=9))
    assert both.n_frames == 120
    for a, b in zip(alone.regions.members, both.regions.members, strict=True):
        np.testing.assert_array_equal(a, b)


def test_symmetric_regions_of_a_face_that_acts_on_one_side(rng):
    data = performer(rng)
    mirror = (np.arange(108).reshape(9, 12)[:, ::-1]).ravel().astype(np.int32)
    moves = data.clips[0].vertices.copy()
    moves[:, data.neutral[:, 0] > 0] = data.neutral[data.neutral[:, 0] > 0] + rng.normal(size=(240, 1, 3))  # as one
    clip = PerformerClip("moving", data.clips[0].times, moves, data.clips[0].rotations, data.clips[0].translations)
    lopsided = PerformerData(
        "M1", data.faces, data.neutral, data.reference, (clip,), "patch", data.vertex_ids, mirror=mirror
    )
    as_it_is = segment_performers([lopsided], (), SegmentOptions(n_regions=6))
    symmetric = segment_performers([lopsided], (), SegmentOptions(n_regions=6, symmetric=True))
    assert symmetric.symmetry > max(0.9, as_it_is.symmetry)
    with pytest.raises(FacewrightError, match="mirror each other"):
        segment_performers(
            [
                PerformerData(
                    "M1",
                    data.faces,
                    data.neutral,
                    data.reference,
                    (clip,),
                    "patch",
                    data.vertex_ids,
                    mirror=np.zeros(108, np.int32),
                )
            ],
            (),
            SegmentOptions(symmetric=True),
        )


def test_refusals(rng):
    data = performer(rng)
    with pytest.raises(FacewrightError, match="frames that are all alike"):
        segment_performers([data], ["still"])
    with pytest.raises(FacewrightError, match="clip must be one of moving, still"):
        segment_performers([data], ["speech"])
    with pytest.raises(FacewrightError, match="frames_per_second"):
        segment_performers([data], (), SegmentOptions(frames_per_second=0.0))
    with pytest.raises(FacewrightError, match="between 1 and the number of vertices, 108"):
        segment_performers([data], (), SegmentOptions(n_regions=109))
    other = PerformerData("F1", data.faces[::-1], data.neutral, data.reference, data.clips, "patch", data.vertex_ids)
    with pytest.raises(FacewrightError, match="registered to one mesh"):
        segment_performers([data, other])


def test_pictures_show_every_region_and_grey_between(rng):
    data = performer(rng)
    labels = (np.arange(108) % 12 >= 6).astype(int)
    face_region = region_of_faces(share_boundaries(labels, data.faces), data.faces)
    assert set(face_region.tolist()) == {-1, 0, 1}
    picture = draw_regions(data.neutral, data.faces, face_region, size=(120, 160), odd=np.array([50]))
    assert picture.shape == (120, 480, 3)
    front = picture[:, 160:320].reshape(-1, 3).astype(float)
    shown = front[np.ptp(front, axis=1) > 40]  # neither background nor grey
    hues = np.argmax(shown, axis=1)
    assert len(shown) > 1000 and len(np.unique(hues)) >= 2
    assert (front.max(axis=1) < 60).sum() > 5  # the marked vertex
    colours = region_colours(13)
    apart = np.linalg.norm(colours[:, None] - colours, axis=2)[np.triu_indices(13, 1)]
    assert apart.min() > 0.1
