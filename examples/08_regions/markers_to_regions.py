"""From markers to regions: docs/images/performers.jpg (RB Fig. 3) and docs/images/regions.jpg (RB Fig. 4).

Four simulated performers wear markers; a generic face is fitted to them, and from then on all are known at the same 397
vertices. How those of the first performer move divides the face into regions.
"""

import argparse
from pathlib import Path

import numpy as np

from facewright.apps.region_pictures import draw_regions, region_of_faces
from facewright.apps.segment_regions import SegmentOptions, segment_performers
from facewright.faces import load_face
from facewright.faces.performers import Performer, simulate_performers
from facewright.fitting.marker_registration import RegisteredPerformer, RegistrationSettings, register_performer
from facewright.imaging.contact_sheet import contact_sheet
from facewright.imaging.overlay import draw_mesh_lines, draw_points
from facewright.imaging.portrait import portrait_view, render_portrait
from facewright.imaging.rasterise import rasterise
from facewright.io.image import write_image
from facewright.models.performer_data import PerformerData
from facewright.models.region_boundaries import share_boundaries

SEED = 0
FRAMES_PER_SECOND = 15.0  # as the paper thins them
SIZE, VIEW = (360, 290), {"centre_mm": (0.0, 8.0, 60.0), "height_mm": 256.0, "yaw_degrees": 14.0}
SKIN, MARKER, LINE = (0.62, 0.65, 0.72), (250, 205, 30), (30, 70, 190)
AFFINITIES = (("correlation 99 %", 0.99), ("distance alone", 0.0), ("correlation 70 %", 0.7))  # lambda of eq. 12


def main(out: Path) -> None:
    """Register the performers, draw them, and segment the first one's face."""
    face, pictures, captions = load_face("builtin"), [], []
    for performer in simulate_performers(face, np.random.default_rng(SEED)):
        first = performer.name == "M1"
        clips = ("neutral", *performer.train[::2], "range_of_motion") if first else ("neutral", "rage_02")
        registered = register(performer, clips, face)
        if first:
            write_image(out / "regions.jpg", regions_sheet(registered.data), quality=85)
        for title, surface, coarse, markers in shown(registered):
            pictures.append(draw(registered, surface, coarse, markers))
            captions.append(f"{performer.name}, {len(markers)} markers" if title == "rest" else title)
    order = [*range(0, 8, 2), *range(1, 8, 2)]
    sheet = contact_sheet([pictures[k] for k in order], [captions[k] for k in order], columns=4)
    write_image(out / "performers.jpg", sheet, quality=88)


def register(performer: Performer, clips: tuple[str, ...], face) -> RegisteredPerformer:
    """Fit the face to what the cameras saw of these clips: noise, gaps and swapped labels included."""
    rng = np.random.default_rng(SEED)
    recorded = {name: performer.clip(name).markers(rng) for name in clips}
    settings = RegistrationSettings(neutral="neutral", frames_per_second=FRAMES_PER_SECOND)
    return register_performer(recorded, face, name=performer.name, settings=settings)


def shown(registered: RegisteredPerformer):
    """Yield title, surface, coarse mesh and markers of the face at rest and where a sentence moves it most."""
    placement = registered.registration.placement
    move = registered.reference_from_head
    places = registered.registration.template.coarse_places
    yield "rest", *(move.apply(p[None])[0] for p in (placement.neutral, placement.neutral[places], placement.rest))
    clip = registered.data.clip("rage_02" if "rage_02" in registered.data.clip_names else "rage_01")
    frame = int(np.abs(clip.vertices - registered.data.neutral).sum(axis=(1, 2)).argmax())
    markers = registered.markers[clip.name][frame]
    surface = registered.registration.surface(markers[None])[0]
    yield (
        f"{clip.name}, {clip.times[frame]:.1f} s",
        *(move.apply(p[None])[0] for p in (surface, surface[places], markers)),
    )


def draw(registered: RegisteredPerformer, surface: np.ndarray, coarse: np.ndarray, markers: np.ndarray) -> np.ndarray:
    """Draw the fitted surface, its 397 vertices' mesh (blue) and the markers (yellow)."""
    faces = registered.registration.template.faces
    image = render_portrait(surface, faces, SIZE, albedo=np.broadcast_to(SKIN, surface.shape), **VIEW).image
    camera, pixels = portrait_view(coarse, SIZE, **VIEW)
    image = draw_mesh_lines(image, pixels, camera[:, 2] - 2.0, registered.data.faces, colour=LINE, opacity=0.9)
    camera, pixels = portrait_view(surface, SIZE, **VIEW)
    depth = rasterise(pixels, camera[:, 2], faces, SIZE).depth
    behind, dots = portrait_view(markers, SIZE, **VIEW)
    x, y = (np.clip(np.rint(dots[:, k]).astype(int), 0, SIZE[1 - k] - 1) for k in (0, 1))
    return draw_points(image, dots[behind[:, 2] < depth[y, x] + 4.0], MARKER, 2.2)


def regions_sheet(data: PerformerData) -> np.ndarray:
    """Draw the clusters of three affinities: fewer than stay compact, as many, one more."""
    search = segment_performers([data]).segmentation
    counts = search.chosen.n_clusters + np.array([-3, 0, 1])
    pictures, captions = [], []
    for count, known in zip(counts.tolist(), (None, search.chosen, search.refused), strict=True):
        for name, share in AFFINITIES:
            options = SegmentOptions(correlation_share=share, n_regions=count)
            paper = share == SegmentOptions().correlation_share
            found = known if paper and known else segment_performers([data], options=options).segmentation.chosen
            face_region = region_of_faces(share_boundaries(found.labels, data.faces), data.faces)
            views = draw_regions(data.neutral, data.faces, face_region, size=(300, 260))
            pictures.append(views[:, 260:520])  # the one from the front
            captions.append(f"{count}, {name}{'' if found.compact else ': not compact'}")
    return contact_sheet(pictures, captions, columns=3)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    main(parser.parse_args().out)
