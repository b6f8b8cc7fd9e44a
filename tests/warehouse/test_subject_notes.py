"""What is told of a subject that was built."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from facewright.warehouse.subject_notes import fold_sentences, subject_notes

UNSTEADY = "Frames differ by {} mm (median), and by {} mm as a patch: the expression was not held."
METRES = (
    "Depths of /data/my people/anna/{} look like metres, not millimetres (the nearest things at {}): "
    "multiplied by 1000."
)


def facts(name, *warnings):
    """As one expression's part of the provenance, where fusion's warnings stand twice."""
    return {"recording": name, "fusion": {"warnings": list(warnings[:1])}, "warnings": list(warnings)}


def test_a_subject_without_troubles_has_no_notes():
    assert subject_notes({"source": "captures", "expressions": {"neutral": facts("neutral")}, "failed": {}}) == ()


@pytest.mark.parametrize("provenance", [{}, {"source": "generated"}, {"expressions": 3, "failed": None}])
def test_other_provenance_gives_no_notes(provenance):
    assert subject_notes(provenance) == ()


def test_a_sentence_is_told_once_for_all_its_expressions_with_the_range_of_its_numbers():
    names = ["smile", "grin", "anger", "dimpler", "sadness"]
    expressions = {n: facts(n, UNSTEADY.format(f"1.{k}", f"{8 + k}.5")) for k, n in enumerate(names)}
    provenance = {"expressions": {"neutral": facts("neutral"), **expressions}}
    told = UNSTEADY.format("1.0 to 1.4", "8.5 to 12.5")
    assert subject_notes(provenance) == (f"5 of 6 expressions: {told}",)
    assert subject_notes(provenance, most_named=9) == (f"{', '.join(names)}: {told}",)


def test_metres_are_told_without_the_path_that_differs():
    expressions = {n: facts(n, METRES.format(n, at)) for n, at in (("neutral", 0.69), ("smile", 0.5))}
    (note,) = subject_notes({"expressions": expressions})
    assert note == (
        "neutral, smile: Depths of the recording look like metres, not millimetres (the nearest things at 0.5 to 0.69):"
        " multiplied by 1000."
    )


def test_dropped_expressions_come_first_with_their_reason():
    expressions = {"neutral": facts("neutral", "The recording has one frame only.")}
    reason = "/data/anna/grin/depth/0.066667.png must be a whole picture, got one that is truncated."
    failed = {"grin": {"kind": "FileFormatError", "reason": reason}}
    first, second = subject_notes({"expressions": expressions, "failed": failed})
    assert first == f"grin is left out: {reason}" and second == "neutral: The recording has one frame only."


def test_numbers_in_names_and_paths_are_left_alone():
    told = [("a", "/x/person-007/0.5.png is 3 wide."), ("b", "/x/person-008/0.5.png is 3 wide.")]
    assert fold_sentences(told) == [(["a"], told[0][1]), (["b"], told[1][1])]


@example([("a", "#"), ("b", "1")])
@given(st.lists(st.tuples(st.sampled_from("abc"), st.text("ab 12.#-/", max_size=12)), max_size=8))
def test_nothing_is_lost_and_single_sentences_stay_as_they_are(told):
    folded = fold_sentences(told)
    assert sorted(about for names, _ in folded for about in names) == sorted(about for about, _ in told)
    alone = {sentence for names, sentence in folded if len(names) == 1}
    assert alone <= {sentence for _, sentence in told}
