"""What was unusual about a subject, from its provenance: few sentences, each told once for all its expressions."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

_NUMBER = re.compile(r"(?<![\w./-])\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w/]|\.\d)")
_MOST_NAMED = 3


def subject_notes(provenance: Mapping[str, Any], most_named: int = _MOST_NAMED) -> tuple[str, ...]:
    """Return what a user should know of a subject that was built: expressions left out, and warnings.

    Parameters
    ----------
    provenance : mapping
        Of the subject, as `process_subject` writes it; any other gives no notes.
    most_named : int
        Up to so many expressions are named where a sentence is about several; more are counted.

    Returns
    -------
    tuple of str
        A sentence that differs between expressions in its numbers only is told once, with the range of the numbers.

    Examples
    --------
    >>> blurred = {"recording": "grin", "warnings": ["Frames differ by 1.2 mm: blurred."]}
    >>> smile = {"recording": "smile", "warnings": ["Frames differ by 2.5 mm: blurred."]}
    >>> failed = {"anger": {"kind": "NoFaceError", "reason": "anger must show a face."}}
    >>> subject_notes({"expressions": {"smile": smile, "grin": blurred}, "failed": failed})
    ('anger is left out: anger must show a face.', 'smile, grin: Frames differ by 1.2 to 2.5 mm: blurred.')
    """
    expressions = _mapping(provenance.get("expressions"))
    reasons = [
        (name, str(_mapping(failure).get("reason", "its recording could not be used.")))
        for name, failure in _mapping(provenance.get("failed")).items()
    ]
    warnings = []
    for name, facts in expressions.items():
        where = str(_mapping(facts).get("recording", name))
        told = [*_texts(facts, "warnings"), *_texts(_mapping(facts).get("fusion"), "warnings")]
        warnings += [(name, _without_path(sentence, where)) for sentence in dict.fromkeys(told)]
    left_out = [
        f"{_names(names, most_named, 0)} {'is' if len(names) == 1 else 'are'} left out: {sentence}"
        for names, sentence in fold_sentences(reasons)
    ]
    others = [
        f"{_names(names, most_named, len(expressions))}: {sentence}" for names, sentence in fold_sentences(warnings)
    ]
    return (*left_out, *others)


def fold_sentences(told: Iterable[tuple[str, str]]) -> list[tuple[list[str], str]]:
    """Join sentences that differ in their numbers only.

    Parameters
    ----------
    told : iterable of (str, str)
        What a sentence is about, and the sentence.

    Returns
    -------
    list of (list of str, str)
        What a sentence is about, in the order given, and the sentence with "2 to 5" where the numbers differ.

    Examples
    --------
    >>> fold_sentences([("a", "Lost 2 of 9."), ("b", "Lost 5 of 9."), ("c", "Dark.")])
    [(['a', 'b'], 'Lost 2 to 5 of 9.'), (['c'], 'Dark.')]
    """
    groups: dict[tuple[str, ...], list[tuple[str, str]]] = {}
    for about, sentence in told:
        groups.setdefault(tuple(_NUMBER.split(sentence)), []).append((about, sentence))
    return [
        ([about for about, _ in group], _with_ranges([sentence for _, sentence in group])) for group in groups.values()
    ]


def _with_ranges(sentences: Sequence[str]) -> str:
    """Return the first sentence with the range of each number over all of them."""
    columns = iter(zip(*(_NUMBER.findall(sentence) for sentence in sentences)))

    def replace(_: re.Match[str]) -> str:
        numbers = next(columns)
        low, high = min(numbers, key=float), max(numbers, key=float)
        return low if float(low) == float(high) else f"{low} to {high}"

    return _NUMBER.sub(replace, sentences[0])


def _without_path(sentence: str, recording: str) -> str:
    """Name a recording as such instead of by its path, which differs between expressions."""
    end = rf"/{re.escape(recording)}(?![\w/-]|\.\w)"
    return re.sub(rf"(?<!\S)/.*?{end}|\S*{end}", "the recording", sentence)


def _names(names: Sequence[str], most_named: int, total: int) -> str:
    if len(names) <= most_named:
        return ", ".join(names)
    return f"{len(names)} of {total} expressions" if total else f"{len(names)} expressions"


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _texts(facts: Any, key: str) -> list[str]:
    found = _mapping(facts).get(key)
    return [item for item in found if isinstance(item, str)] if isinstance(found, list | tuple) else []
