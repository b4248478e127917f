"""Features of a background that stands still while the object turns in front of the camera.

On a turntable they match from all sides, and place cameras as if the object did not turn. They are told by what moves
them: the camera alone, which shifts all of them alike. Between views from different sides, nothing else stays at the
same place, in the same direction and of the same size. Highlights do, as lamps stand still too, and are found with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from sculpt_framework.posing.features import Features, matches
from sculpt_framework.spread import spread

if TYPE_CHECKING:
    from scipy.spatial import KDTree

_COMPARED = 32
"""Images that each image is compared with, spread over all of them."""
_REACH, _NEAR, _EXACT = 0.15, 0.01, 0.005
"""Shares of the longer side: by how much the camera may move the background, how exactly it moves all of it, and how
exactly a feature is found again."""
_TURN, _GROWTH = np.radians(20.0), np.log(1.25)
"""By how much direction and size of a feature may differ for it to be the same that stands still."""
_FEWEST = 8
"""Matches of two images of which a shift can be told."""
_SHARE, _VIEWS = 0.3, 0.2
"""Of the matches of two images, the share that moves as the background does, and of the images compared with one, the
share with which that is so, where there is such a background. A fifth: a camera may be moved to several heights, and on
a walk round an object only neighbours are alike, a twentieth of all."""
_IMAGES = 16
"""Fewer are neighbours of each other for the most part, and between neighbours anything may seem to stand still."""
_MOST = 0.9
"""Share of the features of most images: where more stand still, there is nothing before the background."""
_ALIKE = 0.9
"""Cosine between descriptors of the same feature."""
_AROUND = 4
"""Features looked at where one is expected."""
_SEEN_AGAIN = 0.15
"""Share of the compared images in which a feature of the background is found where it is expected: neighbours alone,
between which the object has hardly turned, are fewer."""
_SOLVES = 30


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pair:
    """Two images, and by how much their matches move that keep their direction and size."""

    first: int
    second: int
    matches: int
    moves: Float32[np.ndarray, "m 2"]


def standing(features: Sequence[Features], longer_side: int) -> list[Bool[np.ndarray, " _"]] | None:
    """Which features of each image are on a background that stands still, but for shifts of the whole image by up to a
    seventh of its longer side; None where there is no such background.

    Of a background in motion, and of one that few of the matches are on, nothing is found: then the object decides.
    """
    if len(features) < _IMAGES:
        return None
    compared = spread(range(len(features)), _COMPARED)
    pairs = _pairs(features, compared)
    if not pairs:
        return None
    shifts = _shifts(pairs, len(features), longer_side)
    before_it = np.zeros((len(features), len(features)), bool)
    for pair in pairs:
        if _still(pair, shifts, longer_side) >= _SHARE * pair.matches:
            before_it[pair.first, pair.second] = before_it[pair.second, pair.first] = True
    if np.median(before_it[:, compared].mean(axis=1)) < _VIEWS:
        return None
    times = _found_again(features, compared, shifts, longer_side)
    found = [each >= _SEEN_AGAIN * len(compared) for each in times]
    return None if np.median([each.mean() for each in found if len(each)]) > _MOST else found


def _pairs(features: Sequence[Features], compared: Sequence[int]) -> list[_Pair]:
    small = [each.largest() for each in features]
    directions = [each.directions() for each in small]
    pairs = []
    for second in compared:
        for first in range(len(features)):
            if first == second or (first > second and first in compared):
                continue
            found = matches(directions[first], directions[second])
            one, two = small[first].at(found[:, 0]), small[second].at(found[:, 1])
            moves = (two.places - one.places)[_same_look(one, two)]
            if len(found) >= _FEWEST:
                pairs.append(_Pair(first=first, second=second, matches=len(found), moves=moves))
    return pairs


def _same_look(one: Features, two: Features) -> Bool[np.ndarray, " n"]:
    with np.errstate(divide="ignore", invalid="ignore"):  # Sizes of 0 are like none.
        growth = np.abs(np.log(one.sizes / two.sizes))
    return (np.cos(one.angles - two.angles) > np.cos(_TURN)) & (growth < _GROWTH)


def _shifts(pairs: Sequence[_Pair], count: int, longer_side: int) -> Float64[np.ndarray, "v 2"]:
    """Where the background is in each image, from where most matches of each pair go: by least absolute differences,
    as between neighbours most go with the object."""
    near = _NEAR * longer_side
    edges, moved, votes = [], [], []
    for pair in pairs:
        moves = pair.moves[np.linalg.norm(pair.moves, axis=1) < _REACH * longer_side]
        if len(moves) < _FEWEST // 2:
            continue
        around = np.linalg.norm(moves[:, None] - moves[None], axis=2) < near
        densest = around[around.sum(axis=1).argmax()]
        edges.append((pair.first, pair.second))
        moved.append(moves[densest].mean(axis=0))
        votes.append(densest.sum() / pair.matches)
    if not edges:
        return np.zeros((count, 2))
    first, second = np.array(edges).T
    rows = np.zeros((len(edges), count))
    rows[np.arange(len(edges)), first], rows[np.arange(len(edges)), second] = -1, 1
    weights, shifts = np.array(votes), np.zeros((count, 2))
    for _ in range(_SOLVES):
        scale = np.sqrt(weights)[:, None]
        shifts = np.linalg.lstsq(scale * rows, scale * np.array(moved), rcond=None)[0]
        off = np.linalg.norm(rows @ shifts - np.array(moved), axis=1)
        weights = np.array(votes) / np.maximum(off, 0.1 * near)
    return shifts


def _still(pair: _Pair, shifts: Float64[np.ndarray, "v 2"], longer_side: int) -> int:
    """Matches that move as the background does."""
    shift = shifts[pair.second] - shifts[pair.first]
    if np.linalg.norm(shift) > _REACH * longer_side:  # As behind a camera that is carried round the object.
        return 0
    return int(np.sum(np.linalg.norm(pair.moves - shift, axis=1) < _NEAR * longer_side))


def _found_again(
    features: Sequence[Features], compared: Sequence[int], shifts: Float64[np.ndarray, "v 2"], longer_side: int
) -> list[Int64[np.ndarray, " _"]]:
    """In how many of the compared images each feature is where the background would have it."""
    from scipy.spatial import KDTree

    times = [np.zeros(len(each.places), np.int64) for each in features]
    for other in compared:
        if len(features[other].places):
            tree = KDTree(features[other].places)
            for number, own in enumerate(features):
                if number != other and len(own.places):
                    shift = shifts[other] - shifts[number]
                    times[number] += _found(own, features[other], tree, shift, _EXACT * longer_side)
    return times


def _found(
    own: Features, theirs: Features, tree: "KDTree", shift: Float64[np.ndarray, " 2"], reach: float
) -> Bool[np.ndarray, " n"]:
    """Which features are found again in another image, shifted by so much."""
    there = np.asarray(tree.query(own.places + shift, k=_AROUND, distance_upper_bound=reach)[1])
    one, place = np.nonzero(there < tree.n)  # Where fewer are around, the rest have the number of all.
    mine, other = own.at(one), theirs.at(there[one, place])
    alike = np.einsum("nc,nc->n", mine.directions(), other.directions()) > _ALIKE
    found = np.zeros(len(own.places), bool)
    found[one[alike & _same_look(mine, other)]] = True
    return found
