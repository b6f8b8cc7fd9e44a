"""Changing a person's attributes: which identity weights do what was asked for, and what they do besides."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.faces.attributes import attribute_names, attribute_points, measure_points
from facewright.faces.face import Face
from facewright.mesh.topology import Topology
from facewright.models.attribute_regression import (
    AttributeRegression,
    fit_attribute_regression,
    least_change,
    leave_one_out_r_squared,
)
from facewright.models.bilinear import BilinearModel
from facewright.models.label_regression import fit_label_regression
from facewright.numeric.check import check_choice, check_shape

MAX_DEVIATIONS = 4.0
#: Standard deviations that an attribute not asked for may move at the price of one of Mahalanobis length.
HOLD = 0.25
#: "least change" obtains what was asked for; "regression" is eq. (12) of FaceWarehouse as it stands.
FORMS = ("least change", "regression")

_STEPS = 4  # attributes are nearly linear in the weights; two steps reach 1e-3 standard deviations
_DIFFERENCE = 1e-3  # of weights of size 1, for derivatives: points move by about 0.1 mm
_N_DRAWN = 1000  # people drawn from the prior where a model does not hold its own


@dataclass(frozen=True, eq=False)
class AttributeEdit:
    """What came of a request.

    Parameters
    ----------
    weights : ndarray of shape (I,), float64
        The new identity weights.
    before, after : mapping of str to float
        Measured attributes of the neutral face, millimetres.
    change : mapping of str to float
        Their change, standard deviations of the population.
    likelihood_distance : float
        Mahalanobis length of the change of weights: how far the population reaches that way, standard deviations.
    """

    weights: NDArray[np.float64]
    before: Mapping[str, float]
    after: Mapping[str, float]
    change: Mapping[str, float]
    likelihood_distance: float


class AttributeEditor:
    """Measures and changes attributes in a linear space of neutral faces; `of_model` and `of_face` make it.

    Parameters
    ----------
    topology : Topology
        Of the faces.
    offset : ndarray of shape (V, 3) or None, millimetres
        Face of weights 0; None for none.
    basis : ndarray of shape (I, V, 3), millimetres
        What each identity weight adds.
    people : ndarray of shape (N, I)
        Weights of the population.
    labels : mapping of str to sequence, optional
        Their labels, see `fit_label_regression`.

    Attributes
    ----------
    names : tuple of str
        Measured attributes, see `facewright.faces.attributes.attribute_names`.
    mean, standard_deviation : ndarray of shape (A,), millimetres
        Over the population.
    r_squared : ndarray of shape (A,)
        Share of each measured attribute's variance that the identity weights predict linearly for people left out.
    label_attributes : tuple of LabelAttribute
        Labelled attributes.
    labels_left_out : dict of str to str
        Labels that say nothing, and why.
    n_people : int
        Size of the population.
    """

    def __init__(
        self,
        topology: Topology,
        offset: NDArray[np.floating] | None,
        basis: NDArray[np.floating],
        people: NDArray[np.floating],
        labels: Mapping[str, tuple[str | int | float | bool | None, ...]] | None = None,
    ) -> None:
        self.names = attribute_names(topology)
        self._basis = attribute_points(basis, topology)
        self._offset = np.zeros(self._basis.shape[1:]) if offset is None else attribute_points(offset, topology)
        self._people = np.asarray(people, dtype=np.float64)
        self.n_people = check_shape("people", self._people, "N", len(self._basis))["N"]
        self._measured = self.measure(self._people)
        self.mean, self.standard_deviation = self._measured.mean(axis=0), self._measured.std(axis=0)
        self._covariance = np.cov(self._people.T).reshape(len(self._basis), -1)
        targets = (self._measured - self.mean) / self.standard_deviation
        self.r_squared = leave_one_out_r_squared(self._people, targets)
        self.label_attributes, self.labels_left_out = fit_label_regression(self._people, labels or {})
        self._regression: AttributeRegression | None = None

    @classmethod
    def of_model(cls, model: BilinearModel) -> AttributeEditor:
        """Return the editor of a bilinear model's neutral faces and its training people.

        Where a model does not hold its people (for privacy), as many as needed are drawn from its prior.
        """
        basis = model.expression(model.expression_weights[0])
        people = model.identity_weights
        if len(people) < 3:
            rng = np.random.default_rng(0)
            people = rng.multivariate_normal(
                model.identity_mean, model.identity_covariance, _N_DRAWN, method="eigh", check_valid="ignore"
            )
            return cls(model.topology, None, basis, people)
        return cls(model.topology, None, basis, people, model.labels)

    @classmethod
    def of_face(cls, face: Face) -> AttributeEditor:
        """Return the editor of a face's identity modes, whose population is N(0, 1) on each of them."""
        rng = np.random.default_rng(0)
        people = rng.normal(size=(_N_DRAWN, len(face.identity_basis)))
        return cls(face.topology, face.mean_shape, face.identity_basis, people)

    def measure(self, weights: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the measured attributes (N, A) or (A,), mm, of identity weights (N, I) or (I,)."""
        batch = np.asarray(weights, dtype=np.float64).reshape(-1, len(self._basis))
        measured = measure_points(self._offset + np.tensordot(batch, self._basis, 1), self.names)
        return measured if np.ndim(weights) == 2 else measured[0]

    @property
    def all_names(self) -> tuple[str, ...]:
        """Measured attributes, then labelled ones."""
        return (*self.names, *(label.name for label in self.label_attributes))

    @property
    def regression(self) -> AttributeRegression:
        """Eq. (11)-(12) of FaceWarehouse for the measured attributes.

        Raises
        ------
        DegenerateError
            If there are too few people.
        """
        if self._regression is None:
            self._regression = fit_attribute_regression(self._people, self._measured, self.names)
        return self._regression

    def change(
        self,
        weights: NDArray[np.floating],
        deviations: Mapping[str, float],
        *,
        form: str = "least change",
        hold: float = HOLD,
    ) -> AttributeEdit:
        """Change attributes of a person.

        Parameters
        ----------
        weights : ndarray of shape (I,)
            The person's identity weights.
        deviations : mapping of str to float
            Change of each named attribute in standard deviations of the population, at most 4 either way. Measured
            ones change by exactly that; labelled ones (``age``, ``sex: female``) move the shape as a whole, before.
        form : str
            One of `FORMS`.
        hold : float
            How far the attributes not asked for may move, see
            `facewright.models.attribute_regression.least_change`; for the form "least change".

        Returns
        -------
        AttributeEdit

        Raises
        ------
        ValueRangeError
            If an attribute is unknown (the message names the nearest), a value is out of range or `form` is none.
        """
        check_shape("weights", weights, len(self._basis))
        check_choice("form", form, FORMS)
        wanted = check_deviations(deviations, self.all_names)
        w = np.asarray(weights, dtype=np.float64).copy()
        before = self.measure(w)
        for label in self.label_attributes:
            w += wanted.get(label.name, 0.0) * label.direction
        if not any(wanted.values()):  # nothing changes, to the last bit
            return self._edit(w, w, before)
        measured = {name: value for name, value in wanted.items() if name in self.names}
        if measured and form == "regression":
            w += self.regression.change(measured)
        elif measured:
            w = self._obtain(w, before, measured, hold)
        return self._edit(np.asarray(weights, dtype=np.float64), w, before)

    def leakage(
        self, weights: NDArray[np.floating] | None = None, *, form: str = "least change", hold: float = HOLD
    ) -> NDArray[np.float64]:
        """Return what every measured attribute does (column) when one of them is asked for by 1 (row), (A, A).

        In standard deviations, at identity weights (I,), by default the population's mean: the diagonal is what is
        obtained, the rest leakage.
        """
        w = self._people.mean(axis=0) if weights is None else weights
        rows = [self.change(w, {name: 1.0}, form=form, hold=hold).change for name in self.names]
        return np.array([[row[name] for name in self.names] for row in rows])

    def _obtain(
        self, w: NDArray[np.float64], before: NDArray[np.float64], measured: Mapping[str, float], hold: float
    ) -> NDArray[np.float64]:
        """Return the nearest weights to `w` whose measured attributes are those `before` changed as asked for."""
        asked = np.array([name in measured for name in self.names])
        # What was not asked for stays where `w` has it, which is where labels moved it.
        goal = self.measure(w)
        step = np.array([measured.get(name, 0.0) for name in self.names]) * self.standard_deviation
        goal[asked] = before[asked] + step[asked]
        start, total = w, np.zeros_like(w)
        for _ in range(_STEPS):  # Gauss-Newton: each solve is for the whole change, about the last face
            jacobian = self._jacobian(start + total) / self.standard_deviation[:, None]
            missing = (goal - self.measure(start + total)) / self.standard_deviation
            total = least_change(jacobian, self._covariance, missing + jacobian @ total, asked, hold)
        return start + total

    def _jacobian(self, w: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivative (A, I) of the attributes, millimetres per weight, by central differences."""
        step = _DIFFERENCE * np.eye(len(w))
        return np.asarray((self.measure(w + step) - self.measure(w - step)).T / (2.0 * _DIFFERENCE))

    def _edit(self, start: NDArray[np.float64], w: NDArray[np.float64], before: NDArray[np.float64]) -> AttributeEdit:
        after = self.measure(w)
        change = (after - before) / self.standard_deviation
        values, vectors = np.linalg.eigh(self._covariance)
        kept = values > 1e-10 * values[-1]
        length = np.linalg.norm((vectors[:, kept].T @ (w - start)) / np.sqrt(values[kept]))

        def named(row: NDArray[np.float64]) -> dict[str, float]:
            return dict(zip(self.names, row.tolist()))

        return AttributeEdit(w, named(before), named(after), named(change), float(length))


def check_deviations(deviations: Mapping[str, float], names: tuple[str, ...]) -> dict[str, float]:
    """Return a request with full names of attributes.

    A name may be shortened to its beginning, or a labelled one to its category, where only one attribute fits:
    ``chin`` is ``chin height``, ``female`` is ``sex: female``.

    Raises
    ------
    ValueRangeError
        If a name is unknown or fits several, named twice, or a value is not finite or beyond 4 standard deviations.
    """
    full: dict[str, float] = {}
    for given, value in deviations.items():
        name = _full_name(given, names)
        if name in full:
            raise ValueRangeError(f"attribute {name!r} must be given once, got it twice.")
        if not abs(value) <= MAX_DEVIATIONS:  # NaN too
            raise ValueRangeError(
                f"{name!r} must be changed by -{MAX_DEVIATIONS:g} to {MAX_DEVIATIONS:g} standard deviations, "
                f"got {value:g}."
            )
        full[name] = float(value)
    return full


def _full_name(given: str, names: tuple[str, ...]) -> str:
    wanted = _words(given)
    fitting = [name for name in names if _words(name) == wanted]
    fitting = fitting or [name for name in names if _words(name).startswith(wanted + " ")]
    fitting = fitting or [name for name in names if ":" in name and _words(name.split(":", 1)[1]) == wanted]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        raise ValueRangeError(f"attribute {given!r} must be named in full: {', '.join(fitting)}.")
    near = _nearest(wanted, names)
    hint = f"did you mean {' or '.join(repr(name) for name in near)}? There are" if near else "there are"
    raise ValueRangeError(f"attribute {given!r} is unknown: {hint} {', '.join(names)}.")


def _nearest(wanted: str, names: Iterable[str]) -> list[str]:
    """Return up to two names that are spelt alike, or share a word, the nearest first."""

    def alike(name: str) -> float:
        return difflib.SequenceMatcher(None, wanted, _words(name)).ratio()

    near = [name for name in names if alike(name) >= 0.65 or set(wanted.split()) & set(_words(name).split())]
    return sorted(near, key=alike, reverse=True)[:2]


def _words(name: str) -> str:
    return " ".join(name.replace(":", " ").replace("-", " ").replace("_", " ").lower().split())
