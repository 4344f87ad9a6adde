// Gradients for parameters and the steps that they lead to: the second and the fourth stage.
#pragma once

#include "learner.cuh"

// Adam's decays, and its constants: those of `crates/flip-learn/src/train/adam.rs`.
constexpr float B1 = 0.9f, B2 = 0.999f, EPS = 1e-8f, TINY = 1e-35f;

// A block of parameters under Adam.
struct Moving {
    float *theta, *m, *v;
    float size, scale;

    FN float step(int at, float g) const {
        float mean = B1 * m[at] + (1.0f - B1) * g;
        float square = B2 * v[at] + (1.0f - B2) * g * g;
        mean = top(0.0f - mean, mean) < TINY ? 0.0f : mean;
        square = top(0.0f - square, square) < TINY ? 0.0f : square;
        m[at] = mean, v[at] = square;
        float now = theta[at] - size * mean / (root(square) * scale + EPS);
        theta[at] = now;
        return now;
    }
};

// A network whose gradient is wanted: what its layers saw and what they get back, by rows.
struct Differentiated {
    Moving moving;      // its block
    Net net;            // the same block by layers
    float* slow;        // block that follows at a distance; may be absent
    float tau;
    float* turned;      // copy of the second layer, rows and columns exchanged
    const float *x;     // inputs, `x_down` apart
    int x_down, inputs, outputs;
    const float *h1, *h2, *d1, *d2, *dy;  // layers, and gradients for layers and outputs

    FN float move(const float* at, float gradient) const {
        int place = int(at - moving.theta);
        float now = moving.step(place, gradient);
        if (slow) slow[place] = slow[place] + tau * (now - slow[place]);
        return now;
    }
};

// Jobs of a network's gradient: tiles of the first and of the second layer, columns of the biases and of
// the third layer, and its biases.
FN int jobs(const Differentiated& n, int hidden) {
    int columns = hidden / 4;
    return columns * ((n.inputs + 3) / 4 + columns) + hidden * (2 + n.outputs) + n.outputs;
}

// Many loads at a time: they are far away, and the sum waits for each.
#if defined(__CUDACC__)
#define FAR _Pragma("unroll 16")
#else
#define FAR
#endif

// Elements of a product over all rows: `x` from four columns, `dy` from four columns.
FN void over_rows(const float* x, int x_down, int valid, const float* dy, int down, int rows, float sums[4][4]) {
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) sums[i][j] = 0.0f;
    if (valid >= 4 && x_down % 4 == 0) {
#if defined(__CUDACC__)
#pragma unroll 8
#endif
        for (int row = 0; row < rows; row++) {
            float4 a = four(x + size_t(row) * x_down), b = four(dy + size_t(row) * down);
            float as[4] = {a.x, a.y, a.z, a.w}, bs[4] = {b.x, b.y, b.z, b.w};
            for (int i = 0; i < 4; i++)
                for (int j = 0; j < 4; j++) sums[i][j] = fused(as[i], bs[j], sums[i][j]);
        }
        return;
    }
#if defined(__CUDACC__)
#pragma unroll 8
#endif
    for (int row = 0; row < rows; row++) {
        float4 b = four(dy + size_t(row) * down);
        float bs[4] = {b.x, b.y, b.z, b.w};
        for (int i = 0; i < 4; i++) {
            float a = i < valid ? x[size_t(row) * x_down + i] : 0.0f;
            for (int j = 0; j < 4; j++) sums[i][j] = fused(a, bs[j], sums[i][j]);
        }
    }
}

FN float column_sum(const float* from, int down, int rows) {
    float sum = 0.0f;
    FAR for (int row = 0; row < rows; row++) sum = sum + from[size_t(row) * down];
    return sum;
}

FN void job(const Differentiated& n, int i, int h, int rows) {
    int columns = h / 4, first = (n.inputs + 3) / 4 * columns, second = columns * columns;
    float sums[4][4];
    if (i < first) {
        int at = i / columns * 4, c = i % columns * 4;
        over_rows(n.x + at, n.x_down, n.inputs - at, n.d1 + c, h, rows, sums);
        for (int k = 0; k < 4 && at + k < n.inputs; k++)
            for (int j = 0; j < 4; j++) n.move(n.net.w1 + (at + k) * h + c + j, sums[k][j]);
        return;
    }
    i -= first;
    if (i < second) {
        int at = i / columns * 4, c = i % columns * 4;
        over_rows(n.h1 + at, h, 4, n.d2 + c, h, rows, sums);
        for (int k = 0; k < 4; k++)
            for (int j = 0; j < 4; j++) {
                n.turned[(c + j) * h + at + k] = n.move(n.net.w2 + (at + k) * h + c + j, sums[k][j]);
            }
        return;
    }
    i -= second;
    if (i < h) {
        n.move(n.net.b1 + i, column_sum(n.d1 + i, h, rows));
        return;
    }
    i -= h;
    if (i < h) {
        n.move(n.net.b2 + i, column_sum(n.d2 + i, h, rows));
        return;
    }
    i -= h;
    if (i < h * n.outputs) {
        int output = i / h, k = i % h;
        float sum = 0.0f;
        FAR for (int row = 0; row < rows; row++) {
            sum = fused(n.dy[size_t(row) * n.outputs + output], n.h2[size_t(row) * h + k], sum);
        }
        n.move(n.net.w3 + k * n.outputs + output, sum);
        return;
    }
    i -= h * n.outputs;
    n.move(n.net.b3 + i, column_sum(n.dy + i, n.outputs, rows));
}

// The critics: both, and their slow copies.
FN Differentiated critic_to_step(const All& all, const float* scales, int k) {
    const Sizes& z = all.s;
    const Training& t = all.t;
    size_t from = size_t(k) * critic_length(z), layer = size_t(k) * z.rows * z.hidden;
    Differentiated n;
    n.moving = Moving{t.critics + from, t.critics_m + from, t.critics_v + from, scales[0], scales[1]};
    n.net = all.critics[2 + k];
    n.slow = t.targets + from;
    n.tau = z.tau;
    n.turned = t.critics_turned + size_t(k) * z.hidden * z.hidden;
    n.x = all.d.now, n.x_down = n.inputs = z.state + ACTIONS, n.outputs = 1;
    n.h1 = t.c1 + layer, n.h2 = t.c2 + layer, n.d1 = t.dc1 + layer, n.d2 = t.dc2 + layer;
    n.dy = t.dq + size_t(k) * z.rows;
    return n;
}

FN Differentiated actor_to_step(const All& all, const float* scales) {
    const Sizes& z = all.s;
    const Training& t = all.t;
    Differentiated n;
    n.moving = Moving{t.actor, t.actor_m, t.actor_v, scales[2], scales[3]};
    n.net = all.actor;
    n.slow = nullptr;
    n.tau = 0.0f;
    n.turned = t.actor_turned;
    n.x = all.d.now, n.x_down = z.state + ACTIONS, n.inputs = z.inputs, n.outputs = HEAD;
    n.h1 = t.a1, n.h2 = t.a2, n.d1 = t.da1, n.d2 = t.da2, n.dy = t.dhead;
    return n;
}

// Losses of the update, and the temperature's step.
FN void temperature(const All& all, const float* scales, double* losses) {
    const Sizes& z = all.s;
    const Training& t = all.t;
    double critics = 0.0, actor = 0.0, log_probs = 0.0, alpha = double(all.alpha);
    for (int k = 0; k < 2; k++) {
        double sum = 0.0;
        FAR for (int row = 0; row < z.rows; row++) {
            float d = t.q[k * z.rows + row] - t.y[row], size = top(0.0f - d, d);
            sum += double(!z.huber || size < 1.0f ? d * d : 2.0f * size - 1.0f);
        }
        critics += sum;
    }
    FAR for (int row = 0; row < z.rows; row++) {
        double log_prob = double(t.log_prob[row]);
        actor += log_prob * alpha - double(bottom(t.new_q[row], t.new_q[z.rows + row]));
        log_probs += log_prob;
    }
    double mean = log_probs / double(z.rows);
    losses[0] = critics / double(2 * z.rows);
    losses[1] = actor / double(z.rows);
    losses[2] = -mean;
    losses[3] = alpha;
    float gradient = float(-alpha * (mean + z.target_entropy));
    Moving{t.log_alpha, t.log_alpha + 1, t.log_alpha + 2, scales[2], scales[3]}.step(0, gradient);
}

// Copies of the second layers by columns, of parameters that come from elsewhere.
FN void turn(Block b, const All& all) {
    int h = all.s.hidden;
    for (int i = b.thread; i < h * h; i += b.threads) {
        int from = i % h * h + i / h;
        all.t.actor_turned[i] = all.actor.w2[from];
        for (int k = 0; k < 2; k++) all.t.critics_turned[size_t(k) * h * h + i] = all.critics[2 + k].w2[from];
    }
}

// What an update works on; the temperature is read anew by everyone who needs it.
FN All all_of(const Sizes& s, float* training, const float* drawn) {
    All all;
    size_t length;
    all.s = s;
    all.t = training_at(training, s, &length);
    all.d = drawn_at(drawn, s);
    all.actor = net_at(all.t.actor, s.inputs, s.hidden, HEAD);
    for (int k = 0; k < 4; k++) {
        float* block = k < 2 ? all.t.targets : all.t.critics;
        block += size_t(k & 1) * critic_length(s);
        all.critics[k] = net_at(block, s.state + ACTIONS, s.hidden, 1);
    }
    all.alpha = exponential(all.t.log_alpha[0]);
    return all;
}

// One stage of one update, by one block of the group; a barrier of the group follows.
FN void stage(Block b, const Shared& shared, const All& all, int which, int block, const float* scales, double* losses) {
    const Sizes& z = all.s;
    if (which == 0 || which == 2) {
        // No smaller than a chunk, which costs the same however many of its rows are there.
        int share = most(CHUNK, (z.rows + z.blocks - 1) / z.blocks);
        int end = least(z.rows, (block + 1) * share);
        for (int row = block * share; row < end; row += CHUNK) {
            if (which == 0) present_rows(b, shared, all, row, least(CHUNK, end - row));
            else actor_rows(b, shared, all, row, least(CHUNK, end - row));
        }
        return;
    }
    int first = block * b.threads + b.thread, apart = z.blocks * b.threads;
    if (which == 1) {
        Differentiated critics[2] = {critic_to_step(all, scales, 0), critic_to_step(all, scales, 1)};
        int count = jobs(critics[0], z.hidden);
        for (int i = first; i < 2 * count; i += apart) job(critics[i / count], i % count, z.hidden, z.rows);
        return;
    }
    Differentiated actor = actor_to_step(all, scales);
    int count = jobs(actor, z.hidden);
    for (int i = first; i < count + 1; i += apart) {
        if (i < count) job(actor, i, z.hidden, z.rows);
        else temperature(all, scales, losses);
    }
}
