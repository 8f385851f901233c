"""Curves of a radius: the shortest between two poses, and the cheapest along a polyline.

A pose is a place with a heading. The shortest curve between two is an arc, a straight line and an arc (Dubins 1957). An
arc is a polyline whose every corner is rounded by the same arc: its legs are tangents.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from joulemap.planner.pricing.kernels import path_energy

HEADINGS = 64
"""Of a circle: a corner of an arc is 5.6 deg, and lies 0.12 % of the radius beside it."""
CORNER = 2.0 * math.pi / HEADINGS
_POSES = 64
"""Of a path, between which curves are tried: 2,000 pairs."""
_ROUND = 1e-9


@njit(cache=True)
def moved(pose, length):
    """A pose further along its heading, which is clockwise from north."""
    return pose[0] - length * math.cos(pose[2]), pose[1] + length * math.sin(pose[2]), pose[2]


@njit(cache=True)
def _turned(angle):
    """An angle in 0..2 pi, of which a hair less than a whole turn is none."""
    angle %= 2.0 * math.pi
    return 0.0 if angle > 2.0 * math.pi - _ROUND else angle


@njit(cache=True)
def curve(begin, end, radius):
    """The shortest arc, straight line and arc between two poses (row, col, heading), as a polyline (n, 2).

    radius : of both arcs [cells]. Where a heading is NaN, the curve has any heading there, and no arc. The result is
    empty where there is none.
    """
    least = np.inf
    word = 0.0, 0.0, 0.0, 0.0
    for side in (1.0, -1.0):  # of the centre of the first arc: to the right, to the left
        for other in (1.0, -1.0):
            s1, s2 = 0.0 if math.isnan(begin[2]) else side, 0.0 if math.isnan(end[2]) else other
            h1, h2 = begin[2] if s1 != 0.0 else 0.0, end[2] if s2 != 0.0 else 0.0
            east = end[1] + s2 * radius * math.cos(h2) - begin[1] - s1 * radius * math.cos(h1)
            north = begin[0] + s1 * radius * math.sin(h1) - end[0] - s2 * radius * math.sin(h2)
            apart, across = math.hypot(east, north), (s1 - s2) * radius
            if apart < abs(across) or (apart == 0.0 and s1 == 0.0):
                continue
            heading = math.atan2(east, north) + (math.asin(across / apart) if across != 0.0 else 0.0)
            if apart == 0.0:
                heading = h1
            straight = math.sqrt(max(apart * apart - across * across, 0.0))
            turn1, turn2 = abs(s1) * _turned(s1 * (heading - h1)), abs(s2) * _turned(s2 * (h2 - heading))
            length = radius * (turn1 + turn2) + straight
            if length < least:
                least, word = length, (s1 * turn1, straight, s2 * turn2, heading)
    if least == np.inf:
        return np.empty((0, 2))
    corners = math.ceil(abs(word[0]) / CORNER - _ROUND), math.ceil(abs(word[2]) / CORNER - _ROUND)
    points = np.empty((2 + corners[0] + corners[1], 2))
    points[0, 0], points[0, 1] = begin[0], begin[1]
    pose = begin[0], begin[1], begin[2] if word[0] != 0.0 else word[3]
    at = 1
    for part in range(2):
        count, turn = corners[part], word[2 * part]
        for _ in range(count):
            tangent = radius * math.tan(0.5 * abs(turn) / count)
            pose = moved(pose, tangent)
            points[at, 0], points[at, 1] = pose[0], pose[1]
            at += 1
            pose = moved((pose[0], pose[1], pose[2] + turn / count), tangent)
        if part == 0:
            pose = moved(pose, word[1])
    points[at, 0], points[at, 1] = end[0], end[1]
    return points


@njit(cache=True, nogil=True)
def rounded(prices, radius, line, poses, at):
    """The polyline (m, 2) with curves between some of its poses where that is cheaper; empty where no way keeps to the
    radius.

    poses : (n, 3) along it, both ends among them; a heading is NaN where any will do. at : (n,) which of the vertices
    of the line each of them follows.
    """
    count = min(_POSES, len(poses))
    some = [k * (len(poses) - 1) // (count - 1) for k in range(count)]
    least, before = np.full(count, np.inf), np.full(count, -1)
    least[0] = 0.0
    for b in range(1, count):
        for a in range(b):
            for driven in range(2 if b == a + 1 else 1):
                points = _between(line, poses, at, (some[a], some[b]), radius, driven == 1)
                total = least[a] + path_energy(prices, points) if len(points) > 0 else np.inf
                if total < least[b]:
                    least[b], before[b] = total, 2 * a + driven
    b = count - 1
    path = poses[-1:, :2].copy() if before[b] >= 0 else np.empty((0, 2))
    while before[b] >= 0:
        a = before[b] // 2
        points = _between(line, poses, at, (some[a], some[b]), radius, before[b] % 2 == 1)
        path, b = np.concatenate((points[:-1] if a == 0 else points[1:-1], path)), a
    return path


@njit(cache=True)
def _between(line, poses, at, ends, radius, driven):
    """The polyline between two of the poses: a curve, or along the line; empty where it does not keep to the radius."""
    a, b = ends
    if not driven:
        return curve(poses[a], poses[b], radius)
    points = np.concatenate((poses[a : a + 1, :2], line[at[a] + 1 : at[b] + 1], poses[b : b + 1, :2]))
    return points if _keeps(points, radius, poses[a, 2], poses[b, 2]) else np.empty((0, 2))


@njit(cache=True)
def _keeps(points, radius, begin_rad, end_rad):
    """Whether an arc of the radius fits into the legs at every corner, and the line has its headings at both ends."""
    heading = np.empty(len(points) + 1)
    for k in range(1, len(points)):
        heading[k] = math.atan2(points[k, 1] - points[k - 1, 1], points[k - 1, 0] - points[k, 0])
    heading[0] = heading[1] if math.isnan(begin_rad) else begin_rad
    heading[-1] = heading[-2] if math.isnan(end_rad) else end_rad
    bend = np.abs((np.diff(heading) + math.pi) % (2.0 * math.pi) - math.pi)
    if max(bend[0], bend[-1]) > 1e-6:
        return False
    for k in range(1, len(points)):
        room = math.hypot(points[k, 0] - points[k - 1, 0], points[k, 1] - points[k - 1, 1])
        if radius * (math.tan(0.5 * bend[k - 1]) + math.tan(0.5 * bend[k])) > room + _ROUND:
            return False
    return True
