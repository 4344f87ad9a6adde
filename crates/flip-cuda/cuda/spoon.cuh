// One spoon, substep by substep: the sequence of flip-sim's lib.rs and grains.rs.
#pragma once
#include "list.cuh"

// The sums over one grain's contacts, in units of `Work::c`.
struct Sum {
    int x, y, z, contacts;
};

FN Sum in_units(Vec correction, bool touches) {
    return Sum{rounded(correction.x * CORRECTION_UNIT), rounded(correction.y * CORRECTION_UNIT),
               rounded(correction.z * CORRECTION_UNIT), touches};
}

FN void gather(Sum& sum, const Sum& more) {
    sum.x += more.x;
    sum.y += more.y;
    sum.z += more.z;
    sum.contacts += more.contacts;
}

// Adds to a grain's sums, which other threads add to as well.
FN void give(const Work& work, int j, const Sum& sum) {
    int* to = &work.c[j].x;
    take_ticket(to, sum.x);
    take_ticket(to + 1, sum.y);
    take_ticket(to + 2, sum.z);
    if (sum.contacts != 0) take_ticket(to + 3, sum.contacts);
}

// A pair's correction, for both: what one grain gets the other one loses, to the last bit.
FN void exchange(const Work& work, int j, Vec correction, bool touches, Sum& sum) {
    Sum mine = in_units(correction, touches);
    gather(sum, mine);
    give(work, j, Sum{-mine.x, -mine.y, -mine.z, mine.contacts});
}

// A grain as its neighbours see it.
struct Seen {
    Vec p;
    float share;
    Vec v;
};

// What does not change within a substep.
struct Pairs {
    Strengths c;
    float near2, onset;            // squared distance of any force; distance at which touch begins
    bool attract;
};

// The correction of a pair, of the grain that lists it.
struct Pull {
    Vec correction;
    bool acts, touches;
};

// A neighbour with whom the contact is remembered, or begins.
template <bool BEGINS>
FN Pull contact(const Work& work, const Pairs& law, const Seen& me, int j, uint2 anchor,
                uint2* keep) {
    const Strengths& c = law.c;
    float4 other = work.p[j];
    Vec velocity = sub(me.v, load3(work.v, j));
    Vec offset = sub(me.p, first3(other));
    float distance2 = dot(offset, offset);
    if (!(distance2 < law.near2)) return Pull{offset, false, false};
    float inverse = inverse_root(distance2);
    Vec normal = scale(offset, inverse);
    float gap = distance2 * inverse - law.onset;
    float along = 0.0f - attract(gap, c);
    if (!(gap < 0.0f)) return Pull{scale(normal, along), true, false};
    float share = me.share * other.w;
    float push = separate(gap, dot(velocity, normal), c.normal, c.normal_damping * share);
    Vec stuck = BEGINS ? offset : unpack(anchor);
    Held held = stick(offset, stuck, velocity, normal, c.tangential_damping * share,
                      c.friction * push, c);
    if (BEGINS || held.slips) *keep = pack(held.anchor);
    return Pull{sub(scale(normal, along + push), held.correction), true, true};
}

// A neighbour without contact: its attraction, or that a contact begins.
FN Pull attraction(const Work& work, const Pairs& law, const Seen& me, int j) {
    Vec offset = sub(me.p, first3(work.p[j]));
    float distance2 = dot(offset, offset);
    if (!(distance2 < law.near2)) return Pull{offset, false, false};
    float inverse = inverse_root(distance2);
    float gap = distance2 * inverse - law.onset;
    if (gap < 0.0f) return Pull{offset, false, true};
    float along = 0.0f - attract(gap, law.c);
    return Pull{scale(scale(offset, inverse), along), law.attract, false};
}

// Adds the neighbours in touch. Returns the slots of contacts that ended.
FN Bits add_contacts(const Work& work, const Pairs& law, Memory& memory, int i, const Seen& me,
                     int count, Sum& sum) {
    // The next neighbour and this one's anchor are fetched while this one is computed.
    const Place* slot = &memory.slots[0][i];
    uint2* keep = &memory.anchors[0][i];
    int next = *slot, top = longest(count);
    Bits ended = 0;
    ONE_BY_ONE
    for (int k = 0; k < top; k++) {
        int j = next;
        slot += GRAINS;
        Pull pull = Pull{me.p, false, true};
        if (k < count) {
            uint2 anchor = *keep;
            next = *slot;
            pull = contact<false>(work, law, me, j, anchor, keep);
        }
        meet();
        if (pull.acts) exchange(work, j, pull.correction, pull.touches, sum);
        if (!pull.touches) ended |= 1u << k;
        keep += GRAINS;
        meet();
    }
    return ended;
}

// Adds the neighbours without contact in `count` slots from `first` on, upwards or downwards.
// Returns the slots in which contacts begin.
template <int STEP>
FN Bits add_tier(const Work& work, const Pairs& law, const Memory& memory, int i, const Seen& me,
                 int first, int count, Sum& sum) {
    Bits begun = 0;
    const Place* slot = &memory.slots[first][i];
    int next = count > 0 ? *slot : 0, top = longest(count);
    ONE_BY_ONE
    for (int k = 0; k < top; k++) {
        int j = next;
        slot += STEP * GRAINS;
        Pull pull = Pull{me.p, false, false};
        if (k < count) {
            if (k + 1 < count) next = *slot;
            pull = attraction(work, law, me, j);
        }
        meet();
        if (pull.acts) exchange(work, j, pull.correction, false, sum);
        if (pull.touches) begun |= 1u << (first + STEP * k);
        meet();
    }
    return begun;
}

FN void swap_slots(Memory& memory, int i, int a, int b) {
    Place other = memory.slots[a][i];
    memory.slots[a][i] = memory.slots[b][i];
    memory.slots[b][i] = other;
}

// Puts touching neighbours first again: `ended` and `begun` are the slots of contacts that ended, and
// of those that begin and are still to be added.
FN void rearrange(const Work& work, const Pairs& law, Memory& memory, int i, const Seen& me,
                  Bits ended, Bits begun, Count& count, Sum& sum) {
    ONE_BY_ONE
    for (int k = count.touching - 1; k >= 0 && ended != 0; k--) {
        if ((ended >> k & 1) == 0) continue;
        ended &= ~(1u << k);
        int last = --count.touching;
        swap_slots(memory, i, k, last);
        memory.anchors[k][i] = memory.anchors[last][i];
    }
    ONE_BY_ONE
    for (; begun != 0; begun &= begun - 1) {
        int slot = lowest(begun), to = count.touching;
        int j = memory.slots[slot][i];
        if (slot >= SLOTS - count.later && to == count.near) {
            // There is no near neighbour to change places with: the later ones close up.
            int last = SLOTS - count.later;
            memory.slots[slot][i] = memory.slots[last][i];
            memory.slots[to][i] = Place(j);
            count.later--;
            count.near++;
        } else {
            swap_slots(memory, i, slot, to);
        }
        Pull pull = contact<true>(work, law, me, j, make_uint2(0, 0), &memory.anchors[to][i]);
        exchange(work, j, pull.correction, true, sum);
        count.touching++;
    }
}

// Adds the contact with the spoon; returns whether it touches.
FN bool add_wall(const Law& law, Memory& memory, int i, const Seen& me, Vec u, bool touched,
                 Sum& sum) {
    const Strengths& c = law.wall;
    Touch near = bowl(law, me.p);
    if (!(near.gap < c.reach)) return false;
    float gap = near.gap - c.onset;
    float along = 0.0f - attract(gap, c);
    Vec correction = vec(0.0f, 0.0f, 0.0f);
    bool touches = gap < 0.0f;
    if (touches) {
        float opening = dot(u, near.normal);
        float push = separate(gap, opening, c.normal, c.normal_damping * me.share);
        Vec anchor = touched ? first3(memory.wall[i]) : me.p;
        Held held = stick(me.p, anchor, u, near.normal, c.tangential_damping * me.share,
                          c.friction * push, c);
        if (!touched || held.slips) memory.wall[i] = with(held.anchor, 0.0f);
        along += push;
        correction = held.correction;
    }
    gather(sum, in_units(sub(scale(near.normal, along), correction), touches));
    return touches;
}

FN Vec coasting(Vec v, const Law& law, float2 body) {
    return scale(vec(v.x + body.x, v.y, v.z + body.y), law.drag);
}

// Sums the corrections of the grain at place `i`, or of none, at the predicted positions.
FN void correct_one(const Work& work, const Law& law, const Pairs& pairs, Memory& memory, int i,
                    bool is_one, Bits packed, float2 body) {
    Count count = unpack_count(packed);
    float4 p = work.p[i];
    Seen me = Seen{first3(p), p.w, load3(work.v, i)};
    Sum sum = Sum{0, 0, 0, 0};
    Bits ended = add_contacts(work, pairs, memory, i, me, count.touching, sum);
    Bits begun = add_tier<1>(work, pairs, memory, i, me, count.touching,
                             count.near - count.touching, sum);
    begun |= add_tier<-1>(work, pairs, memory, i, me, SLOTS - 1, count.later, sum);
    if ((ended | begun) != 0) rearrange(work, pairs, memory, i, me, ended, begun, count, sum);
    meet();
    if (is_one) {
        Vec u = coasting(me.v, law, body);
        count.wall = add_wall(law, memory, i, me, u, count.wall, sum);
    }
    meet();
    if (!is_one) return;
    if (pack_count(count) != packed) memory.count[i] = pack_count(count);
    give(work, i, sum);
}

// Sums the corrections of every grain.
FN void correct(const Block& block, const Work& work, const Law& law, Spoon& spoon, int grains,
                float2 body) {
    Memory& memory = spoon.memory[spoon.head.generation];
    float reach = 1.0f + law.grain.reach;
    Pairs pairs =
        Pairs{law.grain, reach * reach, 1.0f + law.grain.onset, law.grain.attraction > 0.0f};
    // Without attraction nothing happens beyond touch.
    if (!pairs.attract) pairs.near2 = pairs.onset * pairs.onset;
    Bits ahead = block.thread < grains ? memory.count[block.thread] : 0;
    for (int i = block.thread; block.goes_on(i, grains); i += block.threads) {
        bool is_one = i < grains && work.p[i].x < 0.5f * FAR;
        Bits packed = is_one ? ahead : 0;
        if (i + block.threads < grains) ahead = memory.count[i + block.threads];
        correct_one(work, law, pairs, memory, is_one ? i : 0, is_one, packed, body);
        meet();
    }
}

// What happens besides the motion after a substep.
struct Check {
    bool collects;                 // grains that left are taken out, and speeds looked at
    bool predicts;                 // the next substep's acceleration is known
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

// The prediction for one grain; returns whether it strayed from its path.
FN bool predict_one(const Work& work, const Law& law, const Spoon& spoon, int i, Vec x, Vec v,
                    float share, float2 body, float time) {
    Vec p = add(x, coasting(v, law, body));
    work.p[i] = with(p, share);
    Vec off = sub(p, path_at(law, spoon, i, time));
    return !(dot(off, off) < (SKIN - PATH_ERROR) * (SKIN - PATH_ERROR));
}

// A spoon at work: what all threads of its block know alike.
struct Run {
    int grains, fault, substeps;
    float age, horizon;            // of the list, substeps
    bool is_predicted, strayed;    // whether the next prediction is made, and with what result
};

FN float ahead(const Run& run) { return smaller(run.age + 1.0f, run.horizon); }

// Predicts the state without contacts; returns whether one of this thread's grains strayed from its
// path.
FN bool predict(const Block& block, const Work& work, const Law& law, const Spoon& spoon,
                const Run& run, float2 body) {
    bool strayed = false;
    float time = ahead(run);
    for (int i = block.thread; i < run.grains; i += block.threads) {
        Vec x = load3(work.x, i);
        if (x.x > 0.5f * FAR) {
            work.p[i] = make_float4(FAR, FAR, FAR, 1.0f);
            continue;
        }
        Vec v = load3(work.v, i);
        strayed |= predict_one(work, law, spoon, i, x, v, work.p[i].w, body, time);
    }
    return strayed;
}

// A grain's sums, which begin anew.
FN int4 take_sum(const Work& work, int i) {
    int4 c = work.c[i];
    work.c[i] = make_int4(0, 0, 0, 0);
    return c;
}

// Moves every grain and, if asked to, takes out those that left. Returns the largest squared speed of
// this thread's grains.
FN float collect(const Block& block, const Work& work, const Law& law, int grains, float2 body,
                 const Check& check, const Losses& losses) {
    float fastest2 = 0.0f;
    for (int i = block.thread; i < grains; i += block.threads) {
        Vec x = load3(work.x, i);
        if (x.x > 0.5f * FAR) continue;
        int4 c = take_sum(work, i);
        Vec v = add(coasting(load3(work.v, i), law, body), correction_of(c));
        x = add(x, v);
        work.p[i].w = share_of(float(c.w));
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

// Moves every grain and predicts the next substep, whose acceleration is `next`. Returns whether one
// of this thread's grains strayed from its path.
FN bool move(const Block& block, const Work& work, const Law& law, const Spoon& spoon,
             const Run& run, float2 body, float2 next) {
    bool strayed = false;
    float time = ahead(run);
    for (int i = block.thread; i < run.grains; i += block.threads) {
        Vec x = load3(work.x, i);
        if (x.x > 0.5f * FAR) continue;
        int4 c = take_sum(work, i);
        Vec v = add(coasting(load3(work.v, i), law, body), correction_of(c));
        x = add(x, v);
        store3(work.x, i, x);
        store3(work.v, i, v);
        strayed |= predict_one(work, law, spoon, i, x, v, share_of(float(c.w)), next, time);
    }
    return strayed;
}

// One substep. If asked to, it goes on to predict the next one, whose acceleration is `next`, or
// collects the grains that left and returns the largest squared speed.
FN float substep(const Block& block, const Work& work, const Law& law, Spoon& spoon, Run& run,
                 float2 body, float2 next, const Check& check, const Losses& losses) {
    if (!run.is_predicted) {
        // A list of no age does not exist yet.
        run.strayed =
            block.any(run.age < 0.0f || predict(block, work, law, spoon, run, body));
    }
    if (run.strayed) {
        run.horizon = build(block, work, law, spoon, run.grains, run.fault);
        run.age = 0.0f;
        predict(block, work, law, spoon, run, body);
        block.barrier();
    }
    correct(block, work, law, spoon, run.grains, body);
    if (check.collects && block.thread == 0) work.tally[FASTEST] = 0;
    block.barrier();
    run.age += 1.0f;
    run.substeps++;
    run.is_predicted = check.predicts;
    if (check.predicts) {
        run.strayed = block.any(move(block, work, law, spoon, run, body, next));
        return 0.0f;
    }
    float fastest2 = collect(block, work, law, run.grains, body, check, losses);
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
            bool collects = in_slice == law.slice - 1;
            // After a check rest may end, and after a motion without rest another one begins.
            bool predicts = !collects && (k + 1 != todo.substeps || todo.rest_max > 0);
            Check check = Check{collects, predicts, job.place, part, moves ? k : -1};
            float2 body = moves ? bodies[todo.first + k] : standing;
            float2 next = k + 1 < todo.substeps ? bodies[todo.first + k + 1] : standing;
            float fastest2 = substep(block, work, law, spoon, run, body, next, check, losses);
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
    Run run = Run{spoon.head.grains, spoon.head.fault, 0, -1.0f, 0.0f, false, false};
    for (int i = block.thread; i < run.grains; i += block.threads) {
        store3(work.x, i, first3(spoon.x[i]));
        store3(work.v, i, first3(spoon.v[i]));
        work.p[i].w = spoon.x[i].w;
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
        spoon.x[i] = with(load3(work.x, i), work.p[i].w);
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
