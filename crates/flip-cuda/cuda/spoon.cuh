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

// Adds to a grain's sums, which other threads add to as well.
FN void give(const Work& work, int i, const Sum& sum) {
    take_ticket(&work.c[i], sum.x);
    take_ticket(&work.c[GRAINS + i], sum.y);
    take_ticket(&work.c[2 * GRAINS + i], sum.z);
    if (sum.contacts != 0) take_ticket(&work.c[3 * GRAINS + i], sum.contacts);
}


#if defined(FLIP_EXTENDED)
// Adds to a grain's torques.
FN void turn(const Work& work, int i, Vec torque) {
    Sum sum = in_units(torque, false);
    take_ticket(&work.torque[i], sum.x);
    take_ticket(&work.torque[GRAINS + i], sum.y);
    take_ticket(&work.torque[2 * GRAINS + i], sum.z);
}
#endif

// What does not change within a substep.
struct Pairs {
    Strengths c;
    float near2, onset;            // squared distance of any force; distance at which touch begins
    bool attract;
#if defined(FLIP_EXTENDED)
    const Law* whole;
    float2 body;
#endif
};

// The correction of a pair's first grain, and where grains turn, the torque over mass of both.
struct Pull {
    Vec correction;
    bool acts, touches;
#if defined(FLIP_EXTENDED)
    bool spans;                    // a liquid bridge does
    Vec torque, other_torque;
#endif
};

// A pair's correction, for both: what one grain gets the other one loses, to the last bit.
FN void exchange(const Work& work, int i, int j, const Pull& pull) {
    Sum sum = in_units(pull.correction, pull.touches);
    give(work, i, sum);
    give(work, j, Sum{-sum.x, -sum.y, -sum.z, sum.contacts});
#if defined(FLIP_EXTENDED)
    if (pull.touches) {
        turn(work, i, pull.torque);
        turn(work, j, pull.other_torque);
    }
#endif
}

FN Pull idle() { return Pull{vec(0.0f, 0.0f, 0.0f), false, false}; }

FN Vec coasting(const Work& work, int i, Vec v, const Law& law, float2 body) {
    Vec u = scale(vec(v.x + body.x, v.y, v.z + body.y), law.drag);
#if defined(FLIP_EXTENDED)
    u = slowed(law.more, u, radius_of(work, law, i));
#endif
    return u;
}

#if defined(FLIP_EXTENDED)
// Whether two grains whose radii have this sum are near enough for any force.
FN bool is_near(const Pairs& law, float distance2, float radii) {
    if (law.whole->more.widest == RADIUS) return distance2 < law.near2;
    float far = radii + pair_reach(*law.whole);
    return distance2 < far * far;
}
#endif

// A pair that touched before, or touches now for the first time; its anchor is kept.
FN Pull contact(const Work& work, const Pairs& law, Memory& memory, int i, int j, bool touched,
                Anchor anchor, int place) {
    const Strengths& c = law.c;
    float4 mine = work.p[i], other = work.p[j];
    Vec offset = sub(first3(mine), first3(other));
    float distance2 = dot(offset, offset);
#if defined(FLIP_EXTENDED)
    float mine_r = radius_of(work, *law.whole, i), other_r = radius_of(work, *law.whole, j);
    if (!is_near(law, distance2, mine_r + other_r)) return idle();
#else
    if (!(distance2 < law.near2)) return idle();
#endif
    Vec velocity = sub(load3(work.v, i), load3(work.v, j));
    float inverse = inverse_root(distance2);
    Vec normal = scale(offset, inverse);
#if defined(FLIP_EXTENDED)
    Sizes sizes = sizes_of(mine_r, other_r);
    float gap = distance2 * inverse - (mine_r + other_r + c.onset);
    float along = 0.0f - attract(gap, c) * sizes.effective;
    const Mechanisms& more = law.whole->more;
    // It forms on contact, and spans a gap until it breaks.
    bool spans = more.bridge > 0.0f && (gap < 0.0f || holds(anchor)) && gap < more.rupture;
    if (spans) along -= bridged(more, gap) * sizes.effective;
    if (!(gap < 0.0f)) return Pull{scale(normal, along), law.attract || spans, false, spans};
    velocity = more.air == 0.0f
        ? scale(velocity, law.whole->drag)
        : sub(coasting(work, i, load3(work.v, i), *law.whole, law.body),
              coasting(work, j, load3(work.v, j), *law.whole, law.body));
#else
    float gap = distance2 * inverse - law.onset;
    float along = 0.0f - attract(gap, c);
    if (!(gap < 0.0f)) return Pull{scale(normal, along), law.attract, false};
#endif
    float share = mine.w * other.w;
    float push = separate(gap, dot(velocity, normal), c.normal, c.normal_damping * share);
    Vec stuck = touched ? place_of(anchor) : offset;
#if defined(FLIP_EXTENDED)
    Vec spin = load3(work.spin, i), other_spin = load3(work.spin, j);
    float distance = distance2 * inverse, lever = distance * sizes.lever, other_lever = distance - lever;
    Vec carried = cross(normal, add(scale(spin, lever), scale(other_spin, other_lever)));
    velocity = add(velocity, carried);
    stuck = sub(stuck, carried);
#endif
    Held held = stick(offset, stuck, velocity, normal, c.tangential_damping * share,
                      c.friction * push, c);
    if (EXTENDED || !touched || held.slips) memory.anchors[place] = stuck_at(held.anchor);
#if defined(FLIP_EXTENDED)
    float4 rolls = touched ? memory.rolls[place] : make_float4(0.0f, 0.0f, 0.0f, 0.0f);
    float age = more.ageing > 0.0f ? rolls.w + 1.0f : 0.0f;
    along -= aged(more, age) * sizes.effective;
    push *= sizes.reduced;
    held.correction = scale(held.correction, sizes.reduced);
#endif
    Pull pull = Pull{sub(scale(normal, along + push), held.correction), true, true};
#if defined(FLIP_EXTENDED)
    Rolled rolled =
        resist(more, first3(rolls), sub(spin, other_spin), sizes.rolling, sizes.reduced, push);
    memory.rolls[place] = with(rolled.stretch, age);
    Vec arm = cross(normal, held.correction);
    pull.torque = sub(scale(arm, lever), rolled.torque);
    pull.other_torque = add(scale(arm, other_lever), rolled.torque);
#endif
    return pull;
}

// A pair without contact: its attraction, or that a contact begins.
FN Pull attraction(const Work& work, const Pairs& law, int i, int j) {
    Vec offset = sub(first3(work.p[i]), first3(work.p[j]));
    float distance2 = dot(offset, offset);
#if defined(FLIP_EXTENDED)
    float mine = radius_of(work, *law.whole, i), other = radius_of(work, *law.whole, j);
    if (!is_near(law, distance2, mine + other)) return idle();
#else
    if (!(distance2 < law.near2)) return idle();
#endif
    float inverse = inverse_root(distance2);
#if defined(FLIP_EXTENDED)
    float gap = distance2 * inverse - (mine + other + law.c.onset);
    if (gap < 0.0f) return Pull{offset, false, true};
    float along = 0.0f - attract(gap, law.c) * sizes_of(mine, other).effective;
#else
    float gap = distance2 * inverse - law.onset;
    if (gap < 0.0f) return Pull{offset, false, true};
    float along = 0.0f - attract(gap, law.c);
#endif
    return Pull{scale(offset, inverse * along), law.attract, false};
}

// Adds the pairs listed as touching.
FN void add_contacts(const Block& block, const Work& work, const Pairs& law, Memory& memory,
                     int contacts) {
    Bits ahead = block.thread < contacts ? memory.touching[block.thread] : 0;
    ONE_BY_ONE
    for (int t = block.thread; block.goes_on(t, contacts); t += block.threads) {
        int i = int(ahead & 0xffff), j = int(ahead >> 16);
        Pull pull = idle();
        if (t < contacts) {
            Anchor anchor = memory.anchors[t];
            if (t + block.threads < contacts) ahead = memory.touching[t + block.threads];
            bool touched = touches(anchor);
            pull = contact(work, law, memory, i, j, touched, anchor, t);
#if defined(FLIP_EXTENDED)
            if (holds(anchor) && !pull.touches) memory.anchors[t].w = pull.spans ? BRIDGED : 0.0f;
#else
            if (touched && !pull.touches) let_go(memory.anchors[t], anchor);
#endif
        }
        meet();
        if (pull.acts) exchange(work, i, j, pull);
        meet();
    }
}

// Adds the other pairs. One that comes to touch goes over to those that do.
FN void add_near(const Block& block, const Work& work, const Pairs& law, Memory& memory,
                 int count) {
    Bits ahead = block.thread < count ? memory.near[block.thread] : NO_PAIR;
    ONE_BY_ONE
    for (int t = block.thread; block.goes_on(t, count); t += block.threads) {
        Bits pair = ahead;
        ahead = t + block.threads < count ? memory.near[t + block.threads] : NO_PAIR;
        int i = int(pair & 0xffff), j = int(pair >> 16);
        Pull pull = idle();
        if (pair != NO_PAIR) pull = attraction(work, law, i, j);
        meet();
        if (pull.touches) {
            int place = take_ticket(&work.tally[TOUCHING], 1);
            // With no room left the pair stays where it is, and the spoon is given up.
            if (place < CONTACTS) {
                memory.near[t] = NO_PAIR;
                memory.touching[place] = pair;
                pull = contact(work, law, memory, i, j, false, nothing(), place);
                // A compiler may round its gap otherwise than that of `attraction`. The place must not
                // keep what another pair left there.
                if (!pull.touches) memory.anchors[place] = nothing();
            }
        }
        meet();
        if (pull.acts) exchange(work, i, j, pull);
        meet();
    }
}

// A grain's contact with the spoon.
FN Pull wall_contact(const Work& work, const Law& law, Memory& memory, int i, float4 p, Vec u,
                     bool touched) {
    const Strengths& c = law.wall;
    Touch near = nearest(law, first3(p));
#if defined(FLIP_EXTENDED)
    float radius = radius_of(work, law, i);
    near.gap += RADIUS - radius;
    if (!(near.gap < larger(c.reach, law.more.charge_reach))) return idle();
#else
    if (!(near.gap < c.reach)) return idle();
#endif
    float gap = near.gap - c.onset;
    float along = 0.0f - attract(gap, c);
#if defined(FLIP_EXTENDED)
    float4 rolls = memory.stretch[i];
    along -= attract_more(gap, radius, rolls.w, law.more);
    // At a wall, the effective radius is the grain's own.
    if (radius != RADIUS) along *= (radius + radius) / mass_of(radius);
#endif
    if (!(gap < 0.0f)) return Pull{scale(near.normal, along), true, false};
    float push = separate(gap, dot(u, near.normal), c.normal, c.normal_damping * p.w);
    Vec anchor = touched ? first3(memory.wall[i]) : first3(p);
#if defined(FLIP_EXTENDED)
    Vec spin = load3(work.spin, i), carried = cross(near.normal, scale(spin, radius));
    u = add(u, carried);
    anchor = sub(anchor, carried);
#endif
    Held held = stick(first3(p), anchor, u, near.normal, c.tangential_damping * p.w,
                      c.friction * push, c);
    if (EXTENDED || !touched || held.slips) memory.wall[i] = with(held.anchor, 0.0f);
    Pull pull = Pull{sub(scale(near.normal, along + push), held.correction), true, true};
#if defined(FLIP_EXTENDED)
    Vec stretch = touched ? first3(rolls) : vec(0.0f, 0.0f, 0.0f);
    Rolled rolled = resist(law.more, stretch, spin, radius, 2.0f, push);
    memory.stretch[i] = with(rolled.stretch, rolls.w);
    pull.torque = sub(scale(cross(near.normal, held.correction), radius), rolled.torque);
#endif
    return pull;
}

// Adds the contacts with the spoon.
FN void add_walls(const Block& block, const Work& work, const Law& law, Memory& memory, int grains,
                  float2 body) {
    ONE_BY_ONE
    for (int i = block.thread; block.goes_on(i, grains); i += block.threads) {
        Pull pull = idle();
        if (i < grains && work.p[i].x < 0.5f * FAR) {
            bool touched = memory.wall_touches[i] != 0;
            Vec u = coasting(work, i, load3(work.v, i), law, body);
            pull = wall_contact(work, law, memory, i, work.p[i], u, touched);
            if (pull.touches != touched) memory.wall_touches[i] = pull.touches;
        }
#if defined(FLIP_EXTENDED)
        // What a wall does is by mass, what grains do to each other is not.
        if (law.more.widest > RADIUS && i < grains) {
            float mass = mass_of(work.radius[i]);
            pull.correction = scale(pull.correction, mass);
            pull.torque = scale(pull.torque, mass);
        }
#endif
        meet();
        if (pull.acts) give(work, i, in_units(pull.correction, pull.touches));
#if defined(FLIP_EXTENDED)
        if (pull.touches) turn(work, i, pull.torque);
#endif
        meet();
    }
}

// Sums the corrections of every grain at the predicted positions.
FN void correct(const Block& block, const Work& work, const Law& law, Spoon& spoon, int grains,
                int contacts, float2 body) {
    Memory& memory = spoon.memory[spoon.head.generation];
    float reach = 1.0f + pair_reach(law);
    Pairs pairs =
        Pairs{law.grain, reach * reach, 1.0f + law.grain.onset, law.grain.attraction > 0.0f};
    // Without attraction nothing happens beyond touch.
#if defined(FLIP_EXTENDED)
    pairs.whole = &law;
    pairs.body = body;
    if (!pairs.attract && law.more.bridge == 0.0f) pairs.near2 = pairs.onset * pairs.onset;
#else
    if (!pairs.attract) pairs.near2 = pairs.onset * pairs.onset;
#endif
    add_contacts(block, work, pairs, memory, contacts);
    add_near(block, work, pairs, memory, least(work.tally[NEAR], PAIRS));
    add_walls(block, work, law, memory, grains, body);
}

// What happens besides the motion after a substep.
struct Check {
    bool collects;                 // grains that left are taken out, and speeds looked at
    bool predicts;                 // the next substep's acceleration is known
    int place, part, substep;      // as in `Departed`
};

// Writes down a grain that left.
FN void note(const Work& work, const Losses& losses, const Check& check, unsigned id, Vec x, Vec v) {
    take_ticket(&work.tally[LISTED_LEFT], 1);
    take_ticket(&work.tally[LEFT], 1);
    Departed& gone = losses.list[take_ticket(losses.count, 1)];
    gone.place = check.place;
    gone.part = check.part;
    gone.substep = check.substep;
#if defined(FLIP_EXTENDED)
    gone.id = id;
#endif
    store3(gone.x, 0, x);
    store3(gone.v, 0, v);
}

// The prediction for one grain; returns whether it strayed from its path.
FN bool predict_one(const Work& work, const Law& law, const Spoon& spoon, int i, Vec x, Vec v,
                    float share, float2 body, float time) {
    Vec p = add(x, coasting(work, i, v, law, body));
    work.p[i] = with(p, share);
    Vec off = sub(p, path_at(law, spoon, i, time));
    return !(dot(off, off) < (SKIN - PATH_ERROR) * (SKIN - PATH_ERROR));
}

// A spoon at work: what all threads of its block know alike.
struct Run {
    int grains, contacts, fault, substeps;
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
            // Apart from each other, so that no two of them are a pair at no distance.
            work.p[i] = make_float4(FAR + 4.0f * float(i), FAR, FAR, 1.0f);
            continue;
        }
        Vec v = load3(work.v, i);
        strayed |= predict_one(work, law, spoon, i, x, v, work.p[i].w, body, time);
    }
    return strayed;
}

// A grain's sums, which begin anew.
FN int4 take_sum(const Work& work, int i) {
    int4 c = make_int4(work.c[i], work.c[GRAINS + i], work.c[2 * GRAINS + i],
                       work.c[3 * GRAINS + i]);
    for (int k = 0; k < 4; k++) work.c[k * GRAINS + i] = 0;
    return c;
}

#if defined(FLIP_EXTENDED)
// A grain's spin after its torques, whose sums begin anew.
FN void spin_up(const Work& work, const Law& law, int i) {
    int4 sum = make_int4(work.torque[i], work.torque[GRAINS + i], work.torque[2 * GRAINS + i], 0);
    for (int k = 0; k < 3; k++) work.torque[k * GRAINS + i] = 0;
    float ease = law.more.ease, radius = radius_of(work, law, i);
    if (radius != RADIUS) ease *= RADIUS * RADIUS / (radius * radius) / mass_of(radius);
    store3(work.spin, i, add(load3(work.spin, i), scale(correction_of(sum), ease)));
}
#endif

// The velocity of a grain after its corrections.
FN Vec moved(const Work& work, const Law& law, int i, int4 c, float2 body) {
#if defined(FLIP_EXTENDED)
    Vec correction = correction_of(c);
    if (law.more.widest > RADIUS) correction = scale(correction, 1.0f / mass_of(work.radius[i]));
    return add(coasting(work, i, load3(work.v, i), law, body), correction);
#else
    return add(coasting(work, i, load3(work.v, i), law, body), correction_of(c));
#endif
}

// Moves every grain and, if asked to, takes out those that left. Returns the largest squared speed of
// this thread's grains.
FN float collect(const Block& block, const Work& work, const Law& law, const Memory& memory,
                 int grains, float2 body, const Check& check, const Losses& losses) {
    float fastest2 = 0.0f;
    for (int i = block.thread; i < grains; i += block.threads) {
        Vec x = load3(work.x, i);
        if (x.x > 0.5f * FAR) continue;
        int4 c = take_sum(work, i);
        Vec v = moved(work, law, i, c, body);
        x = add(x, v);
#if defined(FLIP_EXTENDED)
        spin_up(work, law, i);
#endif
        work.p[i].w = share_of(float(c.w));
        float speed2 = dot(v, v);
        if (check.collects && has_left(law, x)) {
            note(work, losses, check, memory.id[i], x, v);
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
        Vec v = moved(work, law, i, c, body);
        x = add(x, v);
#if defined(FLIP_EXTENDED)
        spin_up(work, law, i);
#endif
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
        run.horizon = build(block, work, law, spoon, run.grains, run.contacts, run.fault);
        run.age = 0.0f;
        predict(block, work, law, spoon, run, body);
        block.barrier();
    }
    correct(block, work, law, spoon, run.grains, run.contacts, body);
    if (check.collects && block.thread == 0) work.tally[FASTEST] = 0;
    block.barrier();
    run.contacts = work.tally[TOUCHING];
    if (run.contacts > CONTACTS) run.fault = OVERFULL, run.contacts = CONTACTS;
    run.age += 1.0f;
    run.substeps++;
    run.is_predicted = check.predicts;
    if (check.predicts) {
        run.strayed = block.any(move(block, work, law, spoon, run, body, next));
        return 0.0f;
    }
    const Memory& memory = spoon.memory[spoon.head.generation];
    float fastest2 = collect(block, work, law, memory, run.grains, body, check, losses);
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
#if defined(FLIP_EXTENDED)
    int elapsed = spoon.head.elapsed + spoon.head.substeps;
#endif
    for (int part = 0; part < job.parts; part++) {
        Part todo = parts[job.first + part];
        float2 standing = make_float2(todo.standing[0], todo.standing[1]);
        int calm = 0, spent = 0;
        for (int k = 0; run.fault == NONE; k++) {
            bool moves = k < todo.substeps;
            spent = k - todo.substeps;
            // A heap is told for how long; the rest of a spoonful ends at a check.
            bool may_end = HEAPS || spent % law.slice == 0;
            if (!moves && may_end && (spent >= todo.rest_max || calm >= law.quiet)) break;
            int in_slice = (moves ? k : spent) % law.slice;
            bool collects = in_slice == law.slice - 1;
            // After a check rest may end, and after a motion without rest another one begins.
            bool predicts = !collects && (k + 1 != todo.substeps || todo.rest_max > 0);
            Check check = Check{collects, predicts, job.place, part, moves ? k : -1};
            float2 body = moves ? bodies[todo.first + k] : standing;
            float2 next = k + 1 < todo.substeps ? bodies[todo.first + k + 1] : standing;
#if defined(FLIP_EXTENDED)
            body.y += shaken(law.more, elapsed + run.substeps);
            next.y += shaken(law.more, elapsed + run.substeps + 1);
#endif
            float fastest2 = substep(block, work, law, spoon, run, body, next, check, losses);
            if (!moves && check.collects) {
                calm = fastest2 < law.rest_speed2 ? calm + law.slice : 0;
            }
        }
        if (block.thread == 0) rests[job.first + part] = most(spent, 0);
    }
}

// Adds the job's new grains to those in memory.
FN void pour(const Block& block, const Work& work, Spoon& spoon, const Job& job, const Added* added) {
    Memory& memory = spoon.memory[spoon.head.generation];
    for (int k = block.thread; k < job.count; k += block.threads) {
        int i = spoon.head.grains + k;
        const Added& grain = added[job.added + k];
        store3(work.x, i, load3(grain.x, 0));
        store3(work.v, i, load3(grain.v, 0));
        work.p[i].w = 1.0f;
        memory.id[i] = grain.id;
        memory.wall_touches[i] = 0;
#if defined(FLIP_EXTENDED)
        store3(work.spin, i, vec(0.0f, 0.0f, 0.0f));
        memory.stretch[i] = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
        work.radius[i] = grain.radius;
#endif
    }
}

// Squared speeds are added up as whole numbers of 40 bits, in two counters.
constexpr float SPEED_UNIT = 1099511627776.0f;  // 2^40
constexpr int SPEED_BITS = 20;

// How high the heap is, and how fast its grains are.
FN void survey(const Block& block, const Work& work, int grains, Outcome& outcome) {
    int* sums = &work.tally[DRIFT];
    if (block.thread < 3) sums[block.thread] = 0;
    if (block.threads < 3) sums[1] = sums[2] = 0;
    block.barrier();
    int apex = 0, low = 0, high = 0;
    for (int i = block.thread; i < grains; i += block.threads) {
        Vec x = load3(work.x, i), v = load3(work.v, i);
        if (x.x > 0.5f * FAR) continue;
        // It touches two others or more.
        if (work.p[i].w < 0.75f && x.z > 0.0f) apex = most(apex, int(bits_of(x.z)));
        unsigned long long speed2 = (unsigned long long)(smaller(dot(v, v), 1.0f) * SPEED_UNIT);
        low += int(speed2 & ((1u << SPEED_BITS) - 1));
        high += int(speed2 >> SPEED_BITS);
    }
    block.raise_to(&sums[0], apex);
    block.add_up(&sums[1], low);
    block.add_up(&sums[2], high);
    block.barrier();
    if (block.thread == 0) {
        outcome.apex = float_of(Bits(sums[0]));
        outcome.speeds[0] = Bits(sums[1]);
        outcome.speeds[1] = Bits(sums[2]);
    }
}

// One job from beginning to end: the state comes from memory and goes back to it.
FN void work_on(const Block& block, const Work& work, const Law& law, Spoon& spoon,
                const Job& job, const Part* parts, const float2* bodies, const Added* added,
                int* rests, const Losses& losses, Outcome& outcome) {
    int before = spoon.head.grains, poured = HEAPS ? job.count : 0;
    Run run = Run{before + poured, spoon.head.contacts, spoon.head.fault, 0, -1.0f, 0.0f, false, false};
    if (HEAPS) pour(block, work, spoon, job, added);
    for (int i = block.thread; i < before; i += block.threads) {
        store3(work.x, i, first3(spoon.x[i]));
        store3(work.v, i, first3(spoon.v[i]));
        work.p[i].w = spoon.x[i].w;
#if defined(FLIP_EXTENDED)
        store3(work.spin, i, first3(spoon.spin[i]));
#endif
    }
    int rebuilds = spoon.head.rebuilds;
    if (block.thread == 0) {
        work.tally[LISTED_LEFT] = spoon.head.left;
        work.tally[LEFT] = 0;
    }
    block.barrier();
    carry_out(block, work, law, spoon, job, parts, bodies, rests, losses, run);
    block.barrier();
    if (HEAPS) survey(block, work, run.grains, outcome);
    for (int i = block.thread; i < run.grains; i += block.threads) {
        spoon.x[i] = with(load3(work.x, i), work.p[i].w);
        spoon.v[i] = with(load3(work.v, i), 0.0f);
#if defined(FLIP_EXTENDED)
        spoon.spin[i] = with(load3(work.spin, i), 0.0f);
#endif
    }
    if (block.thread == 0) {
        Head& head = spoon.head;
        head.grains = run.grains;
        head.contacts = run.contacts;
        head.left = work.tally[LISTED_LEFT];
        head.fault = run.fault;
        head.substeps += run.substeps;
        outcome.left = work.tally[LEFT];
        outcome.fault = run.fault;
        outcome.substeps = run.substeps;
        outcome.rebuilds = head.rebuilds - rebuilds;
        outcome.kept = run.grains - work.tally[LISTED_LEFT];
        outcome.crowded = head.crowded;
        outcome.places = run.grains;
    }
}
