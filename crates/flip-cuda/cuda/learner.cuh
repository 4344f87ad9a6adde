// Updates of Soft Actor-Critic with two hidden layers, of many trainings at once.
//
// What is computed is what `crates/flip-learn/src/train/fused/` computes, number by number in the same
// order, so the results are equal in every bit: each sum runs over its terms one after another, and
// threads share out elements, never the terms of one.
//
// A group of blocks makes the updates of one training. Everything about a row of the batch, forward and
// back, is done by one block, which needs no other row; gradients for parameters sum over all rows and
// follow after a barrier of the group, as does the step that they lead to. That makes four stages:
//
//     rows      actor on next and present observations, targets, critics; back to the critics' layers
//     critics   gradients of the critics, a step of Adam, and the slow targets
//     rows      new critics on the actor's actions; back through them to the actor's layers
//     actor     its gradient, a step of Adam, and the temperature
#pragma once

#include "curves.cuh"

constexpr int CHUNK = 16;    // rows that a block carries through a stage together
constexpr int ACTIONS = 2;   // per row; the actor has twice as many outputs
constexpr int HEAD = 2 * ACTIONS;
constexpr int SCALES = 4;    // of an update: size and scale of Adam for critics, and for actor and temperature
constexpr int LOSSES = 4;    // critics, actor, entropy, temperature

struct Sizes {
    int rows, inputs, state, hidden;  // state: observation and parameters
    int updates;                      // in this launch
    int blocks;                       // of a group
    int huber;
    float gamma, tau;
    double target_entropy;
};

// A network's block: weight `[inputs, outputs]` by rows and bias of each layer.
struct Net {
    float *w1, *b1, *w2, *b2, *w3, *b3;
};

FN Net net_at(float* at, int inputs, int hidden, int outputs) {
    Net n;
    n.w1 = at;
    n.b1 = n.w1 + inputs * hidden;
    n.w2 = n.b1 + hidden;
    n.b2 = n.w2 + hidden * hidden;
    n.w3 = n.b2 + hidden;
    n.b3 = n.w3 + hidden * outputs;
    return n;
}

FN int whole(int count) { return (count + 3) / 4 * 4; }
FN int actor_length(const Sizes& s) {
    return whole((s.inputs + 1) * s.hidden + (s.hidden + 1) * (s.hidden + HEAD));
}
FN int critic_length(const Sizes& s) {
    return whole((s.state + ACTIONS + 1) * s.hidden + (s.hidden + 1) * (s.hidden + 1));
}

// A training: what outlasts a launch, in the order of `src/learner_layout.rs`, then room.
struct Training {
    float *actor, *actor_m, *actor_v;
    float *critics, *targets, *critics_m, *critics_v;
    float* log_alpha;                // with its two means
    float *actor_turned, *critics_turned;  // second layers, rows and columns exchanged
    float *a1, *a2, *da1, *da2, *dhead;    // actor: layers at present rows, and gradients for them
    float *c1, *c2, *dc1, *dc2, *dq;       // critics: likewise, one after the other
    float *q, *y, *new_q, *log_prob, *head, *action, *spread;
};

FN Training training_at(float* at, const Sizes& s, size_t* length) {
    float* start = at;
    auto take = [&](size_t count) {
        float* here = at;
        at += (count + 3) / 4 * 4;
        return here;
    };
    Training t;
    size_t a = actor_length(s), c = critic_length(s), h = s.hidden, layer = size_t(s.rows) * h;
    t.actor = take(a), t.actor_m = take(a), t.actor_v = take(a);
    t.critics = take(2 * c), t.targets = take(2 * c), t.critics_m = take(2 * c), t.critics_v = take(2 * c);
    t.log_alpha = take(3);
    t.actor_turned = take(h * h), t.critics_turned = take(2 * h * h);
    t.a1 = take(layer), t.a2 = take(layer), t.da1 = take(layer), t.da2 = take(layer);
    t.dhead = take(size_t(s.rows) * HEAD);
    t.c1 = take(2 * layer), t.c2 = take(2 * layer), t.dc1 = take(2 * layer), t.dc2 = take(2 * layer);
    t.dq = take(2 * s.rows), t.q = take(2 * s.rows), t.y = take(s.rows), t.new_q = take(2 * s.rows);
    t.log_prob = take(s.rows), t.head = take(size_t(s.rows) * HEAD);
    t.action = take(size_t(s.rows) * ACTIONS), t.spread = take(size_t(s.rows) * ACTIONS);
    *length = at - start;
    return t;
}

// One update's batch, in the order of `src/learner_layout.rs`.
struct Drawn {
    const float *now, *next, *reward, *goes_on, *noise;
};

FN size_t drawn_length(const Sizes& s) {
    return size_t(s.rows) * (2 * s.state + ACTIONS + 2 + 2 * ACTIONS);
}

FN Drawn drawn_at(const float* at, const Sizes& s) {
    Drawn d;
    d.now = at;
    d.next = d.now + size_t(s.rows) * (s.state + ACTIONS);
    d.reward = d.next + size_t(s.rows) * s.state;
    d.goes_on = d.reward + s.rows;
    d.noise = d.goes_on + s.rows;
    return d;
}

// The memory beside the processor: a chunk's inputs and layers by columns, so that four rows of a
// column lie together.
struct Shared {
    float *x[2], *h1[4], *h2[4];
    float *head, *q, *dq, *back;
};

FN int shared_length(const Sizes& s) {
    return CHUNK * (2 * (s.state + ACTIONS) + 8 * s.hidden + 2 * HEAD + 4 + 2 + 2 * ACTIONS);
}

FN Shared shared_at(float* at, const Sizes& s) {
    Shared here;
    auto take = [&](int columns) {
        float* from = at;
        at += CHUNK * columns;
        return from;
    };
    for (int k = 0; k < 2; k++) here.x[k] = take(s.state + ACTIONS);
    for (int k = 0; k < 4; k++) here.h1[k] = take(s.hidden), here.h2[k] = take(s.hidden);
    here.head = take(2 * HEAD), here.q = take(4), here.dq = take(2), here.back = take(2 * ACTIONS);
    return here;
}

FN float4 four(const float* at) { return *reinterpret_cast<const float4*>(at); }
FN void put_four(float* to, float a, float b, float c, float d) {
    *reinterpret_cast<float4*>(to) = make_float4(a, b, c, d);
}

// Four by four elements of a product: rows from `x` `[inner, x_down]`, columns from `w` `[inner, down]`.
FN void tile(const float* x, int x_down, const float* w, int down, int inner, float sums[4][4]) {
#if defined(__CUDACC__)
#pragma unroll 16
#endif
    for (int k = 0; k < inner; k++) {
        float4 a = four(x + size_t(k) * x_down), b = four(w + size_t(k) * down);
        float as[4] = {a.x, a.y, a.z, a.w}, bs[4] = {b.x, b.y, b.z, b.w};
        for (int r = 0; r < 4; r++)
            for (int c = 0; c < 4; c++) sums[r][c] = fused(as[r], bs[c], sums[r][c]);
    }
}

// One layer of one network for a chunk.
struct Layer {
    const float *x, *w, *bias;  // no bias: sums start from zero
    const float* mask;          // of the chunk's form: what is not above zero there becomes zero; else ReLU
    float* shared;              // where to, in the chunk's form
    float* all;                 // and `[rows, hidden]` from the chunk's first row; may be absent
};

FN void layers(Block b, const Layer* all, int count, int inner, int hidden, int rows) {
    int columns = hidden / 4, groups = CHUNK / 4;
    for (int i = b.thread; i < count * groups * columns; i += b.threads) {
        int c = i % columns * 4, r = i / columns % groups * 4;
        const Layer& layer = all[i / columns / groups];
        float sums[4][4];
        for (int j = 0; j < 4; j++) {
            float start = layer.bias ? layer.bias[c + j] : 0.0f;
            for (int k = 0; k < 4; k++) sums[k][j] = start;
        }
        tile(layer.x + r, CHUNK, layer.w + c, hidden, inner, sums);
        for (int j = 0; j < 4; j++) {
            for (int k = 0; k < 4; k++) {
                float sum = sums[k][j];
                if (layer.mask) {
                    sums[k][j] = 0.0f < layer.mask[(c + j) * CHUNK + r + k] ? sum : 0.0f;
                } else {
                    sums[k][j] = top(0.0f, sum);
                }
            }
            put_four(layer.shared + (c + j) * CHUNK + r, sums[0][j], sums[1][j], sums[2][j], sums[3][j]);
        }
        for (int k = 0; layer.all && k < 4 && r + k < rows; k++) {
            put_four(layer.all + size_t(r + k) * hidden + c, sums[k][0], sums[k][1], sums[k][2], sums[k][3]);
        }
    }
}

// Sum of a chunk's row times a column with this distance between its numbers, as sixteen partial sums
// of which each takes every sixteenth term. Sixteen threads beside each other compute it for the same
// row; the first of them gets it.
FN float narrow(Block b, const float* x, int row, const float* w, int apart, int inner) {
#if defined(__CUDACC__)
    float part = 0.0f;
    for (int k = b.thread & 15; k < inner; k += 16) part = fused(x[k * CHUNK + row], w[k * apart], part);
    for (int half = 8; half > 0; half >>= 1) part += __shfl_down_sync(0xffffffffu, part, half, 16);
    return part;
#else
    float parts[16];
    for (int l = 0; l < 16; l++) {
        parts[l] = 0.0f;
        for (int k = l; k < inner; k += 16) parts[l] = fused(x[k * CHUNK + row], w[k * apart], parts[l]);
    }
    for (int half = 8; half > 0; half >>= 1)
        for (int l = 0; l < half; l++) parts[l] += parts[l + half];
    return parts[0];
#endif
}

// Threads that compute one narrow sum.
#if defined(__CUDACC__)
constexpr int TOGETHER = 16;
#else
constexpr int TOGETHER = 1;
#endif

// Values of critics for a chunk, one after the other.
FN void values(Block b, const Shared& s, const Net* critics, int first, int count, int hidden) {
    for (int i = b.thread / TOGETHER; i < count * CHUNK; i += b.threads / TOGETHER) {
        int k = first + i / CHUNK, row = i % CHUNK;
        float sum = narrow(b, s.h2[k], row, critics[k].w3, 1, hidden);
        if (b.thread % TOGETHER == 0) s.q[k * CHUNK + row] = sum + critics[k].b3[0];
    }
}

// Action, its spread, and the logarithm of its density.
FN float squashed(float mean, float log_std, float noise, float* action, float* spread) {
    log_std = bottom(2.0f, top(-20.0f, log_std));
    *spread = exponential(log_std) * noise;
    float u = mean + *spread;
    float gauss = noise * noise * -0.5f - log_std - 0.9189385f;
    float slope = (0.6931471805599453f - u - softplus(u * -2.0f)) * 2.0f;
    *action = tangent(u);
    return gauss - slope;
}

// Gradient for the second layer's outputs from that for one value.
FN void back_from_values(Block b, const Shared& s, const Net* critics, int first, float* const* into, int hidden) {
    for (int i = b.thread; i < 2 * hidden * CHUNK; i += b.threads) {
        int k = i / (hidden * CHUNK), c = i / CHUNK % hidden, row = i % CHUNK;
        float sum = fused(s.dq[k * CHUNK + row], critics[first + k].w3[c], 0.0f);
        into[k][c * CHUNK + row] = 0.0f < s.h2[first + k][c * CHUNK + row] ? sum : 0.0f;
    }
}

// From a chunk's form to rows.
FN void keep(Block b, const float* chunk, float* to, int hidden, int rows) {
    for (int i = b.thread; i < rows * hidden; i += b.threads) to[i] = chunk[i % hidden * CHUNK + i / hidden];
}

struct All {
    Sizes s;
    Training t;
    Net actor, critics[4];  // both targets, then both critics
    Drawn d;
    float alpha;
};

// First stage, for the rows from `row`, up to a chunk of them.
FN void present_rows(Block b, const Shared& s, const All& all, int row, int rows) {
    const Sizes& z = all.s;
    const Training& t = all.t;
    int h = z.hidden, seen = z.state + ACTIONS;
    for (int i = b.thread; i < seen * CHUNK; i += b.threads) {
        int c = i / CHUNK, r = i % CHUNK;
        bool is = r < rows;
        s.x[0][i] = is && c < z.state ? all.d.next[size_t(row + r) * z.state + c] : 0.0f;
        s.x[1][i] = is ? all.d.now[size_t(row + r) * seen + c] : 0.0f;
    }
    b.barrier();
    const Net& a = all.actor;
    size_t at = size_t(row) * h;
    Layer first[2] = {{s.x[0], a.w1, a.b1, nullptr, s.h1[0], nullptr}, {s.x[1], a.w1, a.b1, nullptr, s.h1[1], t.a1 + at}};
    layers(b, first, 2, z.inputs, h, rows);
    b.barrier();
    Layer second[2] = {{s.h1[0], a.w2, a.b2, nullptr, s.h2[0], nullptr}, {s.h1[1], a.w2, a.b2, nullptr, s.h2[1], t.a2 + at}};
    layers(b, second, 2, h, h, rows);
    b.barrier();
    for (int i = b.thread / TOGETHER; i < 2 * HEAD * CHUNK; i += b.threads / TOGETHER) {
        int k = i / (HEAD * CHUNK), j = i / CHUNK % HEAD, r = i % CHUNK;
        float sum = narrow(b, s.h2[k], r, a.w3 + j, HEAD, h);
        if (b.thread % TOGETHER == 0) s.head[i] = sum + a.b3[j];
    }
    b.barrier();
    float* next_log_prob = s.back;
    for (int i = b.thread; i < 2 * rows; i += b.threads) {
        int k = i / rows, r = i % rows;
        const float* noise = all.d.noise + (size_t(k) * z.rows + row + r) * ACTIONS;
        float log_prob = 0.0f;
        for (int j = 0; j < ACTIONS; j++) {
            float mean = s.head[(k * HEAD + j) * CHUNK + r], log_std = s.head[(k * HEAD + ACTIONS + j) * CHUNK + r];
            float action, spread;
            log_prob += squashed(mean, log_std, noise[j], &action, &spread);
            if (k == 0) {
                s.x[0][(z.state + j) * CHUNK + r] = action;
            } else {
                size_t place = size_t(row + r) * ACTIONS + j;
                t.action[place] = action, t.spread[place] = spread;
                t.head[place] = log_std;
            }
        }
        if (k == 0) next_log_prob[r] = log_prob;
        else t.log_prob[row + r] = log_prob;
    }
    b.barrier();
    Layer wide[4], deep[4];
    for (int k = 0; k < 4; k++) {
        const Net& c = all.critics[k];
        size_t place = (size_t(k & 1) * z.rows + row) * h;
        wide[k] = Layer{s.x[k / 2], c.w1, c.b1, nullptr, s.h1[k], k < 2 ? nullptr : t.c1 + place};
        deep[k] = Layer{s.h1[k], c.w2, c.b2, nullptr, s.h2[k], k < 2 ? nullptr : t.c2 + place};
    }
    layers(b, wide, 4, seen, h, rows);
    b.barrier();
    layers(b, deep, 4, h, h, rows);
    b.barrier();
    values(b, s, all.critics, 0, 4, h);
    b.barrier();
    for (int r = b.thread; r < CHUNK; r += b.threads) {
        float first_q = s.q[r], second_q = s.q[CHUNK + r];
        bool is = r < rows;
        float value = (second_q < first_q ? second_q : first_q) - (is ? next_log_prob[r] * all.alpha : 0.0f);
        float y = is ? all.d.reward[row + r] + all.d.goes_on[row + r] * value * z.gamma : 0.0f;
        if (is) t.y[row + r] = y;
        for (int k = 0; k < 2; k++) {
            float q = s.q[(2 + k) * CHUNK + r], d = q - y;
            if (z.huber) d = d < -1.0f ? -1.0f : d > 1.0f ? 1.0f : d;
            float dq = is ? d / float(z.rows) : 0.0f;
            s.dq[k * CHUNK + r] = dq;
            if (is) t.q[k * z.rows + row + r] = q, t.dq[k * z.rows + row + r] = dq;
        }
    }
    b.barrier();
    back_from_values(b, s, all.critics, 2, s.h2, h);
    b.barrier();
    Layer back[2];
    for (int k = 0; k < 2; k++) {
        size_t place = (size_t(k) * z.rows + row) * h;
        keep(b, s.h2[k], t.dc2 + place, h, rows);
        back[k] = Layer{s.h2[k], t.critics_turned + size_t(k) * h * h, nullptr, s.h1[2 + k], s.h1[k], t.dc1 + place};
    }
    layers(b, back, 2, h, h, rows);
    b.barrier();
}

// Third stage, likewise.
FN void actor_rows(Block b, const Shared& s, const All& all, int row, int rows) {
    const Sizes& z = all.s;
    const Training& t = all.t;
    int h = z.hidden, seen = z.state + ACTIONS;
    for (int i = b.thread; i < seen * CHUNK; i += b.threads) {
        int c = i / CHUNK, r = i % CHUNK;
        size_t at = size_t(row + r);
        float x = 0.0f;
        if (r < rows) x = c < z.state ? all.d.now[at * seen + c] : t.action[at * ACTIONS + c - z.state];
        s.x[0][i] = x;
    }
    b.barrier();
    Layer wide[2], deep[2], back[2];
    for (int k = 0; k < 2; k++) {
        const Net& c = all.critics[2 + k];
        wide[k] = Layer{s.x[0], c.w1, c.b1, nullptr, s.h1[k], nullptr};
        deep[k] = Layer{s.h1[k], c.w2, c.b2, nullptr, s.h2[k], nullptr};
        back[k] = Layer{s.h2[2 + k], t.critics_turned + size_t(k) * h * h, nullptr, s.h1[k], s.h1[2 + k], nullptr};
    }
    layers(b, wide, 2, seen, h, rows);
    b.barrier();
    layers(b, deep, 2, h, h, rows);
    b.barrier();
    values(b, s, all.critics + 2, 0, 2, h);
    b.barrier();
    for (int i = b.thread; i < 2 * CHUNK; i += b.threads) {
        int k = i / CHUNK, r = i % CHUNK;
        float own = s.q[i], other = s.q[(1 - k) * CHUNK + r], share = 1.0f / float(z.rows);
        s.dq[i] = r >= rows ? 0.0f : own == other ? -0.5f / float(z.rows) : other < own ? 0.0f : -share;
        if (r < rows) t.new_q[k * z.rows + row + r] = own;
    }
    b.barrier();
    float* into[2] = {s.h2[2], s.h2[3]};
    back_from_values(b, s, all.critics + 2, 0, into, h);
    b.barrier();
    layers(b, back, 2, h, h, 0);
    b.barrier();
    for (int i = b.thread / TOGETHER; i < 2 * ACTIONS * CHUNK; i += b.threads / TOGETHER) {
        int k = i / (ACTIONS * CHUNK), j = i / CHUNK % ACTIONS, r = i % CHUNK;
        const float* w = all.critics[2 + k].w1 + size_t(z.state + j) * h;
        float sum = narrow(b, s.h1[2 + k], r, w, 1, h);
        if (b.thread % TOGETHER == 0) s.back[i] = sum + 0.0f;
    }
    b.barrier();
    float weight = float(double(all.alpha) / double(z.rows));
    for (int i = b.thread; i < ACTIONS * CHUNK; i += b.threads) {
        int j = i / CHUNK, r = i % CHUNK;
        float mean = 0.0f, width = 0.0f;
        if (r < rows) {
            size_t place = size_t(row + r) * ACTIONS + j;
            float a = t.action[place], log_std = t.head[place];
            float du = 2.0f * weight * a + (s.back[i] + s.back[ACTIONS * CHUNK + i]) * (1.0f - a * a);
            mean = du;
            width = -20.0f <= log_std && log_std <= 2.0f ? du * t.spread[place] - weight : 0.0f;
            t.dhead[size_t(row + r) * HEAD + j] = mean;
            t.dhead[size_t(row + r) * HEAD + ACTIONS + j] = width;
        }
        s.head[j * CHUNK + r] = mean, s.head[(ACTIONS + j) * CHUNK + r] = width;
    }
    b.barrier();
    for (int i = b.thread; i < h * CHUNK; i += b.threads) {
        int c = i / CHUNK, r = i % CHUNK;
        float sum = 0.0f;
        for (int j = 0; j < HEAD; j++) sum = fused(s.head[j * CHUNK + r], all.actor.w3[c * HEAD + j], sum);
        size_t at = size_t(row + r) * h + c;
        s.h2[0][i] = r < rows && 0.0f < t.a2[at] ? sum : 0.0f;
        s.h1[1][i] = r < rows ? t.a1[at] : 0.0f;
    }
    b.barrier();
    keep(b, s.h2[0], t.da2 + size_t(row) * h, h, rows);
    Layer last = {s.h2[0], t.actor_turned, nullptr, s.h1[1], s.h1[0], t.da1 + size_t(row) * h};
    layers(b, &last, 1, h, h, rows);
    b.barrier();
}
