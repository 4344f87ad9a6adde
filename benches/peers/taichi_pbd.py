"""Position-based grains written for this comparison in Taichi: what the framework gives, not a product. usage: taichi_pbd.py BED.csv

Each step predicts, lists the neighbours once by a counting sort into cells, and makes Jacobi iterations that average the corrections of a
grain's contacts: overlaps are undone, and the tangential motion of the step up to Coulomb's limit. Single precision, one thread, grains
do not rotate. Lengths in diameters.
"""

import sys

import numpy as np
import scene
import taichi as ti

DT, ITERATIONS = 1e-4, 4
REACH, NEIGHBOURS_MAX = 1.15, 24
FALL = scene.GRAVITY * DT * DT / scene.DIAMETER

ti.init(arch=ti.cpu, cpu_max_num_threads=1, default_fp=ti.f32, log_level=ti.ERROR)
centres = scene.bed(sys.argv[1]) / scene.DIAMETER
n = len(centres)
corner = np.array([3.0 * centres[:, 0].min(), 3.0 * centres[:, 1].min(), 0.0])
X, Y = (int(-2 * side / REACH) + 1 for side in corner[:2])
Z = int(1.2 * centres[:, 2].max() / REACH) + 1
cells = X * Y * Z

start, now, velocity, correction = (ti.Vector.field(3, ti.f32, n) for _ in range(4))
raw, raw_velocity = ti.Vector.field(3, ti.f32, n), ti.Vector.field(3, ti.f32, n)
cell, first, filled = ti.field(ti.i32, n), ti.field(ti.i32, cells + 1), ti.field(ti.i32, cells)
listed, other = ti.field(ti.i32, n), ti.field(ti.i32, (n, NEIGHBOURS_MAX))


@ti.func
def place(x):
    c = ti.cast(x / REACH, ti.i32)
    return ti.Vector([ti.math.clamp(c[0], 0, X - 1), ti.math.clamp(c[1], 0, Y - 1), ti.math.clamp(c[2], 0, Z - 1)])


@ti.kernel
def sort():
    for c in filled:
        filled[c] = 0
    for i in now:
        raw[i], raw_velocity[i] = now[i], velocity[i]
        p = place(now[i])
        cell[i] = (p[0] * Y + p[1]) * Z + p[2]
        filled[cell[i]] += 1
    ti.loop_config(serialize=True)
    for c in range(cells):
        first[c + 1] = first[c] + filled[c]
        filled[c] = 0
    ti.loop_config(serialize=True)
    for i in range(n):
        c = cell[i]
        to = first[c] + filled[c]
        filled[c] += 1
        start[to] = raw[i]
        velocity[to] = raw_velocity[i] - ti.Vector([0.0, 0.0, FALL])
        now[to] = start[to] + velocity[to]


@ti.kernel
def search():
    for i in now:
        p, count = place(start[i]), 0
        for a in range(ti.max(p[0] - 1, 0), ti.min(p[0] + 2, X)):
            for b in range(ti.max(p[1] - 1, 0), ti.min(p[1] + 2, Y)):
                line = (a * Y + b) * Z
                for j in range(first[line + ti.max(p[2] - 1, 0)], first[line + ti.min(p[2] + 1, Z - 1) + 1]):
                    r = now[i] - now[j]
                    if i != j and r.dot(r) < REACH * REACH and count < NEIGHBOURS_MAX:
                        other[i, count] = j
                        count += 1
        listed[i] = count


@ti.func
def slip(motion, depth):
    """The share of a tangential motion that friction takes back, as a vector."""
    length = motion.norm()
    return motion * ti.min(1.0, scene.FRICTION * depth / ti.max(length, 1e-9))


@ti.kernel
def project():
    for i in now:
        total, contacts = ti.Vector([0.0, 0.0, 0.0]), 0
        for k in range(listed[i]):
            j = other[i, k]
            r = now[i] - now[j]
            distance2 = r.dot(r)
            if distance2 < 1.0:
                distance = ti.sqrt(distance2)
                normal, depth = r / distance, 1.0 - distance
                motion = (now[i] - start[i]) - (now[j] - start[j])
                total += 0.5 * (depth * normal - slip(motion - motion.dot(normal) * normal, depth))
                contacts += 1
        depth = 0.5 - now[i][2]
        if depth > 0.0:
            motion = now[i] - start[i]
            total += depth * ti.Vector([0.0, 0.0, 1.0]) - slip(ti.Vector([motion[0], motion[1], 0.0]), depth)
            contacts += 1
        correction[i] = 1.5 * total / ti.max(contacts, 1)
    for i in now:
        now[i] += correction[i]


@ti.kernel
def finish():
    for i in now:
        velocity[i] = now[i] - start[i]


def advance(steps):
    for _ in range(steps):
        sort()
        search()
        for _ in range(ITERATIONS):
            project()
        finish()
    ti.sync()


now.from_numpy((centres - corner).astype(np.float32))
scene.measure(
    "taichi pbd (own)",
    ".".join(map(str, ti.__version__)),
    DT,
    ITERATIONS,
    n,
    advance,
    lambda: (now.to_numpy() + corner) * scene.DIAMETER,
)
