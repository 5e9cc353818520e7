"""Pose graphs with GTSAM's keys for ids: a file of two robots and a landmark, and any file with other ids."""

from __future__ import annotations

from collections.abc import Callable

from nls import Values

A, B, L, X = (ord(letter) << 56 for letter in "ablx")
LABEL = ord("B") << 48
INFORMATION = "0.25 0 0 1 0 4"  # its root and inverse are exact
STEP = f"1 0 0.125 {INFORMATION}"
ROBOTS = f"""PARAMS_SE2OFFSET 3 0.5 0.25 0.125
VERTEX_SE2 {A} 0 0 0
FIX {A}
VERTEX_SE2 {A | 1} 1.1 0 0.01
VERTEX_SE2 {A | 44} 2 0.125 0
VERTEX_SE2 {B} 5 5 0.5
VERTEX_SE2 {B | 1} 5 6 0.5
VERTEX_XY {L | 3} 2 2
EDGE_SE2 {A} {A | 1} {STEP}
EDGE_SE2 {B} {B | 1} {STEP}
EDGE_SE2_POINTXY_OFFSET {B | 1} {L | 3} 3 1.5 2.5 4 0 4
EDGE_SE2 {A | 1} {A | 44} {STEP}
EDGE_SE2 {A | 44} {B} 1.5 2 0.5 {INFORMATION}
EDGE_SE2_POINTXY_OFFSET {A | 1} {L | 3} 3 1.5 2.5 4 0 4
"""


def numbers(values: Values) -> dict[str, list[int]]:
    return {kind: stack.numbers.tolist() for kind, stack in values.stacks.items()}


def without(text: str, *words: str) -> str:
    """The lines whose tag has none of these words."""
    return "".join(f"{x}\n" for x in text.splitlines() if not any(word in x.split()[0] for word in words))


def renamed(text: str, new: Callable[[int], int]) -> str:
    """A pose graph with other ids."""
    lines = [line.split() for line in text.splitlines()]
    for line in lines:
        end = 3 if line[0].startswith("EDGE") else 2
        line[1:end] = [str(new(int(n))) for n in line[1:end]]
    return "".join(" ".join(line) + "\n" for line in lines)
