"""Newton's XPBD solver on Warp's processor backend: points in single precision that do not rotate. usage: newton_xpbd.py BED.csv

Lengths are given to it in mm and masses in ug.
"""

import sys

import newton
import scene
import warp as wp

DT, ITERATIONS, MM, UG = 1e-4, 4, 1e3, 1e9

wp.config.quiet = True
wp.init()
centres = scene.bed(sys.argv[1]) * MM
n = len(centres)
builder = newton.ModelBuilder(up_axis=newton.Axis.Z, gravity=(0.0, 0.0, -scene.GRAVITY * MM))
builder.add_ground_plane(cfg=newton.ModelBuilder.ShapeConfig(mu=scene.FRICTION))
builder.add_particles(
    pos=[wp.vec3(*x) for x in centres],
    vel=[wp.vec3(0.0)] * n,
    mass=[scene.MASS * UG] * n,
    radius=[scene.DIAMETER / 2 * MM] * n,
)
model = builder.finalize(device="cpu")
model.particle_mu = model.soft_contact_mu = scene.FRICTION
model.particle_cohesion = model.particle_adhesion = 0.0
solver = newton.solvers.SolverXPBD(model, iterations=ITERATIONS, soft_contact_relaxation=0.9)
states, control = [model.state(), model.state()], model.control()
collisions = newton.CollisionPipeline(model, soft_contact_gap=0.025 * scene.DIAMETER * MM)
contacts = collisions.contacts()


def advance(steps):
    for _ in range(steps):
        states[0].clear_forces()
        collisions.collide(states[0], contacts)
        solver.step(states[0], states[1], control, contacts, DT)
        states.reverse()


scene.measure(
    "newton xpbd",
    f"{newton.__version__} on warp {wp.__version__}",
    DT,
    ITERATIONS,
    n,
    advance,
    lambda: states[0].particle_q.numpy() / MM,
)
