"""Steps per second of the vectorised environment beside the same doses stepped by a loop in Rust.

    PYTHON benches/python_env.py [--turns 60]

PYTHON is one of an environment with flip-powder and gymnasium, as tests/clients/test_python.py makes in target/clients/python. Both loops step through the
same actions and reset the same episodes, on all cores (RAYON_NUM_THREADS sets how many). They take short turns, and the table has the fastest turn of each, so that
what else the machine does counts little. The environment hands out arrays of their own at every step, as Gymnasium's do.
"""

import argparse
import os
import time

import gymnasium as gym
import numpy as np

import flip_powder.env  # noqa: F401

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--turns", type=int, default=60, help="turns of each loop")
parser.add_argument("--steps", type=int, default=50_000, help="steps of a turn, over all doses")
parser.add_argument("--doses", default="64,256,1024,4096", help="how many doses in lockstep")
asked = parser.parse_args()

print(f"surrogate, {os.environ.get('RAYON_NUM_THREADS', os.cpu_count())} threads, the fastest of {asked.turns} turns")
print("| doses | steps/s, loop in Rust | steps/s, environment | overhead |")
print("|---|---|---|---|")
for count in map(int, asked.doses.split(",")):
    envs = gym.make_vec("FlipWeigh-v0", num_envs=count)
    steps = max(asked.steps // count, 1)
    block = np.random.default_rng(1).uniform(-1, 1, (steps, count, 2)).astype(np.float32)
    doses, flat = envs.unwrapped._doses, block.reshape(-1, 2)

    def rust():
        doses.native.run(flat, doses.arrays)

    def environment():
        for actions in block:
            envs.step(actions)

    fastest = dict.fromkeys((rust, environment), float("inf"))
    for _ in range(asked.turns):
        for loop in fastest:
            envs.reset(seed=1)
            begun = time.perf_counter()
            loop()
            fastest[loop] = min(fastest[loop], time.perf_counter() - begun)
    rates = [f"{steps * count / seconds:,.0f}" for seconds in fastest.values()]
    print(f"| {count} | {rates[0]} | {rates[1]} | {100 * (fastest[environment] / fastest[rust] - 1):.1f} % |", flush=True)
