"""A plain Soft Actor-Critic in JAX, timed in turn with FLIP's.

Prints its version, then for each line `HIDDEN BATCH UPDATES OBSERVATIONS ACTIONS` on stdin the processor seconds that one update took in
that window. Everything that an update does is one compiled program, and so are all updates of a window (`lax.scan`): batch from the replay
memory, twin critics, actor, temperature, slow targets, Adam. Its critics also see nine parameters, as FLIP's do; it draws no new targets in
hindsight. A learner is made, filled and compiled at the first line that asks for it, outside of the clock.

    jax_sac.py card         no lines: updates per second of one learner and of twenty, on JAX's default device
"""

import functools
import os
import sys
import time

if "card" not in sys.argv[1:]:
    os.environ["JAX_PLATFORMS"] = "cpu"
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    # One core for every thread: XLA's pool would otherwise use the others, which the clock also counts.
    os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[-1]})

import jax
import jax.numpy as jnp

REMEMBERED, PARAMETERS = 2000, 9
LEARNING_RATE, GAMMA, TAU, TARGET_ENTROPY = 3e-4, 0.9, 0.005, -2.0


def network(key, widths):
    """Weights and biases, uniform in +-1 / sqrt(inputs)."""
    layers = []
    for inputs, outputs in zip(widths, widths[1:], strict=False):
        key, weight, bias = jax.random.split(key, 3)
        bound = inputs**-0.5
        shape = (inputs, outputs)
        layers.append((jax.random.uniform(weight, shape, minval=-bound, maxval=bound), jax.random.uniform(bias, (outputs,), minval=-bound, maxval=bound)))
    return layers


def forward(layers, x):
    for weight, bias in layers[:-1]:
        x = jax.nn.relu(x @ weight + bias)
    weight, bias = layers[-1]
    return x @ weight + bias


def squash(head, noise):
    mean, log_std = jnp.split(head, 2, axis=-1)
    log_std = jnp.clip(log_std, -20.0, 2.0)
    u = mean + jnp.exp(log_std) * noise
    gauss = -0.5 * noise**2 - log_std - 0.5 * jnp.log(2 * jnp.pi)
    slope = 2 * (jnp.log(2.0) - u - jax.nn.softplus(-2 * u))
    return jnp.tanh(u), (gauss - slope).sum(-1)


def values(critics, seen, action):
    return jax.vmap(lambda critic: forward(critic, jnp.concatenate([seen, action], -1))[:, 0])(critics)


def adam(state, gradient):
    theta, m, v, t = state
    t += 1
    m = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, m, gradient)
    v = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, v, gradient)
    size, scale = LEARNING_RATE / (1 - 0.9**t), (1 - 0.999**t) ** -0.5
    theta = jax.tree.map(lambda theta, m, v: theta - size * m / (jnp.sqrt(v) * scale + 1e-8), theta, m, v)
    return theta, m, v, t


def optimised(theta):
    zero = jax.tree.map(jnp.zeros_like, theta)
    return theta, zero, zero, jnp.zeros(())


def made(key, hidden, observations, actions):
    """A learner's state, and its replay memory."""
    actor_key, critic_key, memory_key = jax.random.split(key, 3)
    actor = network(actor_key, [observations, hidden, hidden, 2 * actions])
    twins = jax.random.split(critic_key, 2)
    critics = jax.vmap(lambda key: network(key, [observations + PARAMETERS + actions, hidden, hidden, 1]))(twins)
    state = (optimised(actor), optimised(critics), critics, optimised(jnp.log(0.2)))
    width = 2 * (observations + PARAMETERS) + actions + 1
    return state, jax.random.uniform(memory_key, (REMEMBERED, width), minval=-1.0)


def update(state, key, memory, batch, observations, actions):
    actor, critics, targets, log_alpha = state
    pick, noise = jax.random.split(key)
    rows = memory[jax.random.randint(pick, (batch,), 0, REMEMBERED)]
    seen, action, after, reward = jnp.split(rows, [observations + PARAMETERS, observations + PARAMETERS + actions, width_of(observations, actions)], axis=-1)
    noise = jax.random.normal(noise, (2, batch, actions))
    alpha = jnp.exp(log_alpha[0])

    next_action, next_log_prob = squash(forward(actor[0], after[:, :observations]), noise[0])
    y = reward[:, 0] + GAMMA * (values(targets, after, next_action).min(0) - alpha * next_log_prob)
    critics = adam(critics, jax.grad(lambda c: ((values(c, seen, action) - y) ** 2).mean())(critics[0]))

    def actor_loss(theta):
        action, log_prob = squash(forward(theta, seen[:, :observations]), noise[1])
        return (alpha * log_prob - values(critics[0], seen, action).min(0)).mean(), log_prob.mean()

    gradient, log_prob = jax.grad(actor_loss, has_aux=True)(actor[0])
    actor = adam(actor, gradient)
    log_alpha = adam(log_alpha, -alpha * (log_prob + TARGET_ENTROPY))
    targets = jax.tree.map(lambda slow, fast: slow + TAU * (fast - slow), targets, critics[0])
    return (actor, critics, targets, log_alpha), None


def width_of(observations, actions):
    return 2 * (observations + PARAMETERS) + actions


@functools.partial(jax.jit, static_argnums=(3, 4, 5, 6))
def window(state, memory, key, updates, batch, observations, actions):
    keys = jax.random.split(key, updates)
    return jax.lax.scan(lambda state, key: update(state, key, memory, batch, observations, actions), state, keys)[0]


def serve():
    print(f"JAX {jax.__version__}", flush=True)
    learners, programs = {}, {}
    for line in sys.stdin:
        hidden, batch, updates, *sizes = map(int, line.split())
        state, memory = learners.get((hidden, batch)) or made(jax.random.key(1), hidden, *sizes)
        key = jax.random.key(2)
        if (hidden, batch, updates) not in programs:
            programs[hidden, batch, updates] = window.lower(state, memory, key, updates, batch, *sizes).compile()
        before = time.process_time()
        state = jax.block_until_ready(programs[hidden, batch, updates](state, memory, key))
        spent = (time.process_time() - before) / updates
        learners[hidden, batch] = state, memory
        print(spent, flush=True)


def card(updates=2000):
    print(f"JAX {jax.__version__} on {jax.devices()[0]}")
    for learners in (1, 20):
        for hidden, batch in [(128, 256), (256, 256), (64, 256), (128, 16)]:
            size = (updates, batch, 4, 2)
            keys = jax.random.split(jax.random.key(1), learners)
            state, memory = jax.vmap(lambda key, hidden=hidden: made(key, hidden, 4, 2))(keys)
            many = jax.vmap(lambda state, memory, key, size=size: window(state, memory, key, *size))
            many = jax.jit(many)
            state = jax.block_until_ready(many(state, memory, keys))
            before = time.perf_counter()
            jax.block_until_ready(many(state, memory, keys))
            rate = learners * updates / (time.perf_counter() - before)
            print(f"{learners} learners, {hidden} units, batch {batch}: {rate:.0f} updates/s", flush=True)


if __name__ == "__main__":
    card() if "card" in sys.argv[1:] else serve()
