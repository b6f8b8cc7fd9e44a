"""What of a character must meet and not cross: lips, lids, lids and eyeballs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.faces.contact import face_contacts
from facewright.faces.face import Face
from facewright.faces.rigid_motion import rigid_vertices
from facewright.mesh.normals import vertex_normals
from facewright.models.character_contact import RADIUS_BINS, LidClearance, Seals

#: Contacts, and below which gap they are drawn together, mm.
_CONTACTS = {"lips": 0.6, "upper_lid_left": 0.6, "upper_lid_right": 0.6}
_LEAST = 1e-3  # of a pair's change: what moves less does not give way
_LID_MM = 6.0  # skin within this distance of an eyeball is its lids'
_CLEAR_MM = 0.25
_FACING = 0.0  # cosine: the lids' inner side faces the eyeball, and goes into it where nobody sees it
_LAYER = 0.12  # of what lies further out at rest: the outer skin of a lid stays in front of its inner side


def character_seals(character: Face) -> Seals:
    """Return the pairs of lips and lids of a character, those of its ``*_contact_*`` masks."""
    skin = character.skin()
    rest = skin.mean_shape.astype(np.float64)
    contacts = face_contacts(rest, skin.topology, skin.topology.faces)
    parts = [contacts[name] for name in _CONTACTS if name in contacts]
    reaches = np.concatenate(
        [np.zeros(0), *(np.full(len(contacts[name].upper), mm) for name, mm in _CONTACTS.items() if name in contacts)]
    )
    if not parts:
        return Seals.none()
    moved, spread = np.zeros(0, np.intp), np.zeros((0, 0))
    for contact in parts:
        K = len(contact.upper)
        response = np.zeros((K, len(rest), 1))
        contact.change(response, np.eye(K)[:, :, None])
        ids = np.flatnonzero(np.abs(response).max(axis=(0, 2)) > _LEAST)
        block = np.zeros((len(moved) + len(ids), spread.shape[1] + K))
        block[: len(moved), : spread.shape[1]] = spread
        block[len(moved) :, spread.shape[1] :] = response[:, ids, 0].T
        moved, spread = np.concatenate([moved, ids]), block
    upper = np.concatenate([contact.upper for contact in parts]).astype(np.intp)
    lower = np.concatenate([contact.lower for contact in parts]).astype(np.intp)
    gaps = rest[upper, 1] - rest[lower, 1]
    floors = np.where(gaps < reaches, gaps, 0.0)  # what rests no further apart is closed as it rests
    return Seals(upper, lower, floors, reaches, moved, spread)


def lid_clearance(character: Face) -> LidClearance:
    """Return the skin next to the eyeballs and the eyeballs' radii; none where a character has no eyeballs."""
    rest, skin = character.mean_shape.astype(np.float64), character.mean_shape[: character.n_skin].astype(np.float64)
    names = [name for name, kind in character.rigid_parts.items() if kind == "eye"]
    if not names:
        return LidClearance.none()
    normals = vertex_normals(skin, character.skin().topology.faces)
    ids, eye, margins, centres, radii = [], [], [], [], []
    for number, name in enumerate(names):
        eyeball = rest[rigid_vertices(character, name)]
        centre = eyeball.mean(axis=0)
        profile = _profile(eyeball - centre)
        arms = skin - centre
        length = np.linalg.norm(arms, axis=1)
        cosine = arms[:, 2] / np.maximum(length, 1e-9)
        above = length - np.interp(cosine, np.linspace(-1.0, 1.0, RADIUS_BINS), profile)
        outward = np.einsum("vc,vc->v", normals, arms) / np.maximum(length, 1e-9)
        near = np.flatnonzero((above < _LID_MM) & (cosine > 0.0) & (outward > _FACING))
        ids.append(near)
        eye.append(np.full(len(near), number))
        margins.append(np.minimum(above[near], _CLEAR_MM + _LAYER * np.maximum(above[near] - _CLEAR_MM, 0.0)))
        centres.append(centre)
        radii.append(profile)
    return LidClearance(
        np.concatenate(ids), np.concatenate(eye), np.concatenate(margins), np.array(centres), np.array(radii)
    )


def _profile(arms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return an eyeball's largest radius over the cosine of the angle to +z, (RADIUS_BINS,)."""
    length = np.linalg.norm(arms, axis=1)
    place = (arms[:, 2] / np.maximum(length, 1e-9) + 1.0) * 0.5 * (RADIUS_BINS - 1)
    profile = np.zeros(RADIUS_BINS)
    for bin_ids in (np.floor(place), np.ceil(place)):
        np.maximum.at(profile, np.clip(bin_ids.astype(int), 0, RADIUS_BINS - 1), length)
    known = np.flatnonzero(profile)
    return np.interp(np.arange(RADIUS_BINS), known, profile[known])
