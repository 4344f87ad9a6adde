// One spoon, substep by substep: the sequence of flip-sim's lib.rs and grains.rs.
#pragma once
#include "list.cuh"

// The sums over one grain's contacts.
struct Sum {
    Vec correction;
    float contacts;
};

// A grain as its neighbours see it.
struct Seen {
    Vec p;
    float share;
    Vec v;
};

// Adds the neighbours of one tier: near ones, or those that may come near.
FN void add_tier(const Work& work, const Law& law, Memory& memory, int i, const Seen& me,
                 Bits touched, int count, int word, int step, Bits& touching, Sum& sum) {
    if (count == 0) return;
    const Strengths& c = law.grain;
    float near2 = (1.0f + c.reach) * (1.0f + c.reach), onset = 1.0f + c.onset;
    uint2 ids = memory.slots[word][i], ahead = ids;
    for (int k = 0; k < count; k++) {
        int lane = k & 3;
        if (lane == 0 && k + 4 < count) ahead = memory.slots[word + step][i];
        int j = int(ids.x & 0xffff), slot = 4 * word + lane;
        ids.x = ids.x >> 16 | ids.y << 16;
        ids.y >>= 16;
        if (lane == 3) {
            ids = ahead;
            word += step;
        }
        float4 other = work.p[j];
        Vec offset = sub(me.p, first3(other));
        float distance2 = dot(offset, offset);
        if (!(distance2 < near2)) continue;
        float inverse = inverse_root(distance2);
        Vec normal = scale(offset, inverse);
        float gap = distance2 * inverse - onset;
        float along = 0.0f - attract(gap, c);
        if (gap < 0.0f) {
            touching |= 1u << slot;
            sum.contacts += 1.0f;
            Vec velocity = scale(sub(me.v, load3(work.v, j)), law.drag);
            float opening = dot(velocity, normal), share = me.share * other.w;
            float push = separate(gap, opening, c.normal, c.normal_damping * share);
            bool is_new = (touched >> slot & 1) == 0;
            Vec anchor = is_new ? offset : unpack(memory.anchors[slot][i]);
            Held held =
                stick(offset, anchor, velocity, normal, opening, share, c.friction * push, c);
            if (is_new || held.slips) memory.anchors[slot][i] = pack(held.anchor);
            along += push;
            sum.correction = sub(sum.correction, held.correction);
        }
        sum.correction = add(sum.correction, scale(normal, along));
    }
}

// Adds the contact with the spoon.
FN void add_wall(const Law& law, Memory& memory, int i, const Seen& me, Vec u, Sum& sum) {
    const Strengths& c = law.wall;
    Touch near = bowl(law, me.p);
    if (!(near.gap < c.reach)) {
        memory.wall[i].w = 0.0f;
        return;
    }
    float gap = near.gap - c.onset;
    float along = 0.0f - attract(gap, c);
    if (!(gap < 0.0f)) {
        memory.wall[i].w = 0.0f;
    } else {
        float opening = dot(u, near.normal);
        float push = separate(gap, opening, c.normal, c.normal_damping * me.share);
        float4 kept = memory.wall[i];
        bool is_new = !(kept.w > 0.0f);
        Vec anchor = is_new ? me.p : first3(kept);
        Held held =
            stick(me.p, anchor, u, near.normal, opening, me.share, c.friction * push, c);
        if (is_new || held.slips) memory.wall[i] = with(held.anchor, 1.0f);
        along += push;
        sum.contacts += 1.0f;
        sum.correction = sub(sum.correction, held.correction);
    }
    sum.correction = add(sum.correction, scale(near.normal, along));
}

FN Vec coasting(Vec v, const Law& law, float2 body) {
    return scale(vec(v.x + body.x, v.y, v.z + body.y), law.drag);
}

// Sums the corrections of every grain at the predicted positions.
FN void correct(const Block& block, const Work& work, const Law& law, Spoon& spoon, int grains,
                float2 body) {
    Memory& memory = spoon.memory[spoon.head.generation];
    for (int i = block.thread; i < grains; i += block.threads) {
        float4 p = work.p[i];
        if (p.x > 0.5f * FAR) {
            work.c[i] = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
            continue;
        }
        Seen me = Seen{first3(p), p.w, load3(work.v, i)};
        Bits count = memory.count[i], touched = memory.touching[i], touching = 0;
        Sum sum = Sum{vec(0.0f, 0.0f, 0.0f), 0.0f};
        add_tier(work, law, memory, i, me, touched, count & 0xff, 0, 1, touching, sum);
        add_tier(work, law, memory, i, me, touched, count >> 8, WORDS - 1, -1, touching, sum);
        if (touching != touched) memory.touching[i] = touching;
        add_wall(law, memory, i, me, coasting(me.v, law, body), sum);
        work.c[i] = with(sum.correction, sum.contacts);
    }
}

// What happens besides the motion after a substep.
struct Check {
    bool collects;                 // grains that left are taken out
    int place, part, substep;      // as in `Departed`
};

// Writes down a grain that left.
FN void note(const Work& work, const Losses& losses, const Check& check, Vec x, Vec v) {
    take_ticket(&work.tally[LISTED_LEFT], 1);
    take_ticket(&work.tally[LEFT], 1);
    Departed& gone = losses.list[take_ticket(losses.count, 1)];
    gone.place = check.place;
    gone.part = check.part;
    gone.substep = check.substep;
    store3(gone.x, 0, x);
    store3(gone.v, 0, v);
}

// Moves every grain, and takes out those that left. Returns the largest squared speed of this
// thread's grains.
FN float move(const Block& block, const Work& work, const Law& law, int grains, float2 body,
              const Check& check, const Losses& losses) {
    float fastest2 = 0.0f;
    for (int i = block.thread; i < grains; i += block.threads) {
        Vec x = load3(work.x, i);
        if (x.x > 0.5f * FAR) continue;
        Vec v = add(coasting(load3(work.v, i), law, body), first3(work.c[i]));
        x = add(x, v);
        float speed2 = dot(v, v);
        if (check.collects && has_left(law, x)) {
            note(work, losses, check, x, v);
            x = vec(FAR, FAR, FAR);
            v = vec(0.0f, 0.0f, 0.0f);
            speed2 = 0.0f;
        }
        // A speed that is NaN counts as the largest.
        if (!(speed2 <= fastest2)) fastest2 = speed2;
        store3(work.x, i, x);
        store3(work.v, i, v);
    }
    return fastest2;
}

// Predicts the state without contacts; returns whether one of this thread's grains strayed from its
// path.
FN bool predict(const Block& block, const Work& work, const Law& law, const Spoon& spoon,
                int grains, float2 body, float age, float horizon) {
    bool strayed = false;
    float time = smaller(age + 1.0f, horizon);
    for (int i = block.thread; i < grains; i += block.threads) {
        Vec x = load3(work.x, i);
        float share = share_of(work.c[i].w);
        if (x.x > 0.5f * FAR) {
            work.p[i] = make_float4(FAR, FAR, FAR, 1.0f);
            continue;
        }
        Vec p = add(x, coasting(load3(work.v, i), law, body));
        work.p[i] = with(p, share);
        Vec path = add(first3(spoon.start[i]), scale(first3(spoon.pace[i]), time));
        Vec off = sub(p, path);
        if (!(dot(off, off) < SKIN * SKIN)) strayed = true;
    }
    return strayed;
}

// A spoon at work: what all threads of its block know alike.
struct Run {
    int grains, fault, substeps;
    float age, horizon;
};

// One substep. Returns the largest squared speed, only if grains that left are collected.
FN float substep(const Block& block, const Work& work, const Law& law, Spoon& spoon, Run& run,
                 float2 body, const Check& check, const Losses& losses) {
    bool strayed = run.age < 0.0f
        || block.any(predict(block, work, law, spoon, run.grains, body, run.age, run.horizon));
    if (run.age < 0.0f) block.barrier();
    if (strayed) {
        run.horizon = build(block, work, law, spoon, run.grains, run.fault);
        run.age = 0.0f;
        predict(block, work, law, spoon, run.grains, body, 0.0f, run.horizon);
        block.barrier();
    }
    correct(block, work, law, spoon, run.grains, body);
    if (check.collects && block.thread == 0) work.tally[FASTEST] = 0;
    block.barrier();
    float fastest2 = move(block, work, law, run.grains, body, check, losses);
    run.age += 1.0f;
    run.substeps++;
    if (!check.collects) return 0.0f;
    // NaN has more bits than any number.
    block.raise_to(&work.tally[FASTEST], int(bits_of(fastest2) & 0x7fffffffu));
    block.barrier();
    fastest2 = float_of(Bits(work.tally[FASTEST]));
    if (!(fastest2 <= 1.0f)) run.fault = TOO_FAST;
    return fastest2;
}

// Carries out the parts of one plan: each motion, then rest until the powder lies still.
FN void carry_out(const Block& block, const Work& work, const Law& law, Spoon& spoon,
                  const Job& job, const Part* parts, const float2* bodies, int* rests,
                  const Losses& losses, Run& run) {
    for (int part = 0; part < job.parts; part++) {
        Part todo = parts[job.first + part];
        float2 standing = make_float2(todo.standing[0], todo.standing[1]);
        int calm = 0, spent = 0;
        for (int k = 0; run.fault == NONE; k++) {
            bool moves = k < todo.substeps;
            spent = k - todo.substeps;
            if (!moves && spent % law.slice == 0 && (spent >= todo.rest_max || calm >= law.quiet)) {
                break;
            }
            int in_slice = (moves ? k : spent) % law.slice;
            Check check = Check{in_slice == law.slice - 1, job.place, part, moves ? k : -1};
            float2 body = moves ? bodies[todo.first + k] : standing;
            float fastest2 = substep(block, work, law, spoon, run, body, check, losses);
            if (!moves && check.collects) {
                calm = fastest2 < law.rest_speed2 ? calm + law.slice : 0;
            }
        }
        if (block.thread == 0) rests[job.first + part] = most(spent, 0);
    }
}

// One job from beginning to end: the state comes from memory and goes back to it.
FN void work_on(const Block& block, const Work& work, const Law& law, Spoon& spoon,
                const Job& job, const Part* parts, const float2* bodies, int* rests,
                const Losses& losses, Outcome& outcome) {
    Run run = Run{spoon.head.grains, spoon.head.fault, 0, -1.0f, 0.0f};
    for (int i = block.thread; i < run.grains; i += block.threads) {
        store3(work.x, i, first3(spoon.x[i]));
        store3(work.v, i, first3(spoon.v[i]));
        work.c[i].w = spoon.x[i].w;
    }
    int rebuilds = spoon.head.rebuilds;
    if (block.thread == 0) {
        work.tally[LISTED_LEFT] = spoon.head.left;
        work.tally[LEFT] = 0;
    }
    block.barrier();
    carry_out(block, work, law, spoon, job, parts, bodies, rests, losses, run);
    block.barrier();
    for (int i = block.thread; i < run.grains; i += block.threads) {
        spoon.x[i] = with(load3(work.x, i), work.c[i].w);
        spoon.v[i] = with(load3(work.v, i), 0.0f);
    }
    if (block.thread == 0) {
        Head& head = spoon.head;
        head.grains = run.grains;
        head.left = work.tally[LISTED_LEFT];
        head.fault = run.fault;
        head.substeps += run.substeps;
        outcome.left = work.tally[LEFT];
        outcome.fault = run.fault;
        outcome.substeps = run.substeps;
        outcome.rebuilds = head.rebuilds - rebuilds;
        outcome.kept = run.grains - work.tally[LISTED_LEFT];
        outcome.crowded = head.crowded;
    }
}
