"""Steps per second of the vectorised environment beside the same doses stepped by a loop in Rust.

    PYTHON benches/python_env.py [--steps 2000000] [--repeats 7]

PYTHON is one of an environment with flip-powder and gymnasium, as tests/clients/test_python.py makes in target/clients/python. Both loops step through the
same actions and reset the same episodes, on all cores (RAYON_NUM_THREADS sets how many); they take turns, and the table has the medians over the
repeats: of each loop's steps per second, and of the overhead within each turn. The environment hands out arrays of their own at every step, as Gymnasium's do.
"""

import argparse
import os
import statistics
import time

import gymnasium as gym
import numpy as np

import flip_powder.env  # noqa: F401

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--steps", type=int, default=2_000_000, help="steps of one turn of one loop, over all doses")
parser.add_argument("--repeats", type=int, default=7, help="turns of each loop")
parser.add_argument("--doses", default="64,256,1024,4096", help="how many doses in lockstep")
asked = parser.parse_args()

threads = os.environ.get("RAYON_NUM_THREADS", f"{os.cpu_count()}")
print(f"surrogate, {asked.steps} steps a turn, {asked.repeats} turns, {threads} threads; per second of the clock, and per second of a processor")
print("| doses | Rust, steps/s | environment, steps/s | overhead | Rust, steps/core-s | environment, steps/core-s | overhead |")
print("|---|---|---|---|---|---|---|")
for count in map(int, asked.doses.split(",")):
    envs = gym.make_vec("FlipWeigh-v0", num_envs=count)
    steps = asked.steps // count
    block = np.random.default_rng(1).uniform(-1, 1, (min(steps, 200), count, 2)).astype(np.float32)
    rounds = max(steps // len(block), 1)
    steps = rounds * len(block)
    doses = envs.unwrapped._doses
    flat = block.reshape(-1, 2)

    def rust():
        for _ in range(rounds):
            doses.native.run(flat, doses.arrays)

    def environment():
        for _ in range(rounds):
            for actions in block:
                envs.step(actions)

    turns = []
    for turn in range(asked.repeats + 1):
        row = []
        for loop in (rust, environment):
            envs.reset(seed=1)
            wall, cpu = time.perf_counter(), time.process_time()
            loop()
            row += [time.perf_counter() - wall, time.process_time() - cpu]
        if turn:  # The first warms up.
            turns.append(row)

    def rate(k):
        return f"{steps * count / statistics.median(turn[k] for turn in turns):,.0f}"

    def overhead(k):
        return f"{100 * (statistics.median(turn[k + 2] / turn[k] for turn in turns) - 1):.1f} %"

    print(f"| {count} | {rate(0)} | {rate(2)} | {overhead(0)} | {rate(1)} | {rate(3)} | {overhead(1)} |", flush=True)
