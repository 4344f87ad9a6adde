"""A spoon of powder in Newton on Warp's processor backend: newton_spoon.py SOLVER BED.npz

SOLVER is `xpbd-US-ITERATIONS` (one sphere for each grain, that does not rotate; time step in us) or `mpm-US` (a continuum, one material
point for each grain). BED.npz, which steps.py writes, has the grains where FLIP's spoon has them when it is filled, and the steps to play:
change of the pitch, shake, and the seconds that the step takes in FLIP. Each line on stdin lets it play all steps once from the start, and is
answered with one line of JSON.

The spoon is solved in its own frame, as FLIP does: pitching turns gravity, shaking adds an inertial force. It has FLIP's form, half an
ellipsoid, as a mesh. A shake goes there and back by half a cosine each way, at the acceleration of FLIP's. Lengths in mm, masses in ug.
"""

import json
import sys
import time

import newton
import numpy as np
import warp as wp

G_MM_S2 = 9810.0
#: Greatest acceleration of a shake, mm/s2, and the speed of pitching, deg/s: FLIP's defaults.
SHAKE_MM_S2, PITCH_DEG_S = 4500.0, 60.0
SEMI_AXES_MM = (5.0, 3.5, 2.0)
SHELL_MM = 0.5
FRICTION, SPOON_FRICTION = 0.5, 0.4


def bowl(semi_axes, shell, around=48, down=16):
    """A closed mesh of half an ellipsoid's hollow in a shell: points and triangles."""
    points, triangles = [], []
    phi, theta = np.linspace(0.0, 2 * np.pi, around, endpoint=False), np.linspace(0.0, np.pi / 2, down + 1)[:-1]
    for grow in (0.0, shell):
        a, b, c = (axis + grow for axis in semi_axes)
        points += [(a * np.cos(t) * np.cos(p), b * np.cos(t) * np.sin(p), -c * np.sin(t)) for t in theta for p in phi]
        points.append((0.0, 0.0, -c))
    layer = down * around + 1

    def quad(one, two, three, four):
        triangles.extend([(one, two, three), (one, three, four)])

    for k in range(around):
        to = (k + 1) % around
        for ring in range(down - 1):
            at, below = ring * around, (ring + 1) * around
            # Seen from the hollow, and seen from outside.
            quad(at + k, at + to, below + to, below + k)
            quad(layer + at + to, layer + at + k, layer + below + k, layer + below + to)
        last = (down - 1) * around
        triangles.append((last + k, last + to, layer - 1))
        triangles.append((layer + last + to, layer + last + k, 2 * layer - 1))
        quad(k, layer + k, layer + to, to)
    return np.array(points, np.float32), np.array(triangles, np.int32).reshape(-1)


def force(pitch_deg, shift_mm_s2):
    """What a grain at rest in the spoon feels, mm/s2: along it towards the tip, across, up."""
    pitch = np.radians(pitch_deg)
    return np.array([G_MM_S2 * np.sin(pitch) - shift_mm_s2, 0.0, -G_MM_S2 * np.cos(pitch)], np.float32)


def course(steps, dt):
    """The force at every time step of the steps."""
    pitch, forces = 0.0, []
    for change, shake, seconds in steps:
        tilt_s = abs(change) / PITCH_DEG_S
        # x = shake / 2 (1 - cos(pi t / T)); its greatest acceleration is shake / 2 (pi / T)^2.
        stroke_s = np.pi * np.sqrt(shake / (2 * SHAKE_MM_S2)) if shake > 0.0 else 0.0
        for t in np.arange(round(seconds / dt)) * dt:
            now = pitch + change * min(t / tilt_s, 1.0) if tilt_s else pitch
            into = t - tilt_s
            moving = 0.0 <= into < 2 * stroke_s
            forces.append(force(now, SHAKE_MM_S2 * np.cos(np.pi * into / stroke_s) if moving else 0.0))
        pitch += change
    return forces


def mean_overlap(centres, diameter):
    """Mean overlap of the pairs that overlap, as a share of the diameter."""
    x = centres[np.argsort(centres[:, 2])]
    last = np.searchsorted(x[:, 2], x[:, 2] + diameter)
    shares = []
    for i in range(len(x) - 1):
        distance = np.linalg.norm(x[i + 1 : last[i]] - x[i], axis=1)
        shares.append(1.0 - distance[distance < diameter] / diameter)
    shares = np.concatenate(shares) if shares else np.zeros(0)
    return float(shares.mean()) if len(shares) else 0.0


class Spoon:
    """The scene with one of the solvers."""

    def __init__(self, solver, centres, radius, mass):
        kind, *numbers = solver.split("-")
        self.dt = int(numbers[0]) * 1e-6
        self.mpm = kind == "mpm"
        builder = newton.ModelBuilder(up_axis=newton.Axis.Z, gravity=(0.0, 0.0, -G_MM_S2))
        if self.mpm:
            newton.solvers.SolverImplicitMPM.register_custom_attributes(builder)
        points, triangles = bowl(SEMI_AXES_MM, SHELL_MM)
        shape = newton.ModelBuilder.ShapeConfig(mu=SPOON_FRICTION)
        builder.add_shape_mesh(-1, mesh=newton.Mesh(points, triangles, compute_inertia=False), cfg=shape)
        count = len(centres)
        builder.add_particles(pos=[wp.vec3(*x) for x in centres], vel=[wp.vec3(0.0)] * count, mass=[mass] * count, radius=[radius] * count)
        self.model = builder.finalize(device="cpu")
        self.control = self.model.control()
        if self.mpm:
            self.model.mpm.friction.fill_(FRICTION)
            config = newton.solvers.SolverImplicitMPM.Config()
            # Newton's examples have two to three points along a cell.
            config.voxel_size = 6.0 * radius
            self.solver = newton.solvers.SolverImplicitMPM(self.model, config=config)
        else:
            self.model.particle_mu, self.model.soft_contact_mu = FRICTION, SPOON_FRICTION
            self.model.particle_cohesion = self.model.particle_adhesion = 0.0
            # Its own grid has 128 cells along each side, which take longer to clear than the grains of a spoon to move.
            self.model.particle_grid = wp.HashGrid(32, 32, 16, device="cpu")
            self.solver = newton.solvers.SolverXPBD(self.model, iterations=int(numbers[1]), soft_contact_relaxation=0.9)
            self.collisions = newton.CollisionPipeline(self.model, soft_contact_gap=0.05 * radius)
            self.contacts = self.collisions.contacts()
        self.begin()

    def begin(self):
        self.now, self.next = self.model.state(), self.model.state()

    def step(self, gravity):
        self.model.gravity.fill_(wp.vec3(*map(float, gravity)))
        if self.mpm:
            self.solver.step(self.now, self.next, None, None, self.dt)
            self.solver.project_outside(self.next, self.next, self.dt)
        else:
            self.now.clear_forces()
            self.collisions.collide(self.now, self.contacts)
            self.solver.step(self.now, self.next, self.control, self.contacts, self.dt)
        self.now, self.next = self.next, self.now

    def centres(self):
        return self.now.particle_q.numpy()


def main():
    wp.config.quiet = True
    wp.init()
    solver, bed = sys.argv[1], np.load(sys.argv[2])
    diameter = 2.0 * float(bed["radius_mm"])
    spoon = Spoon(solver, bed["centres_mm"], diameter / 2.0, float(bed["mass_ug"]))
    forces = course(bed["steps"], spoon.dt)
    for gravity in forces[:3]:
        # Compiles, or reads what was compiled.
        spoon.step(gravity)
    print(json.dumps({"newton": newton.__version__, "warp": wp.__version__}), flush=True)
    for _ in sys.stdin:
        spoon.begin()
        wall, core = time.perf_counter(), time.process_time()
        for gravity in forces:
            spoon.step(gravity)
        done = spoon.centres()
        said = {"wall_s": time.perf_counter() - wall, "core_s": time.process_time() - core, "simulated_s": len(forces) * spoon.dt}
        inside = done[np.isfinite(done).all(1) & (done[:, 2] > -SEMI_AXES_MM[2] - SHELL_MM) & (np.abs(done[:, 0]) < 2 * SEMI_AXES_MM[0])]
        print(json.dumps({**said, "overlap": mean_overlap(inside, diameter), "in_spoon": len(inside) / len(done)}), flush=True)


if __name__ == "__main__":
    main()
