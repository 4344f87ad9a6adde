// Building the list of neighbours. Grains are sorted into cells, the memory of touching pairs is
// carried over, and each grain searches its cell and the 13 after it for grains that come later.
//
// A grain's path starts where it is and follows its velocity for `horizon` substeps. A pair is
// listed if its paths come closer than the reach of a contact plus both grains' skins; the list is
// valid until a grain strays from its path by more than its skin. The horizon is short enough that
// grains further apart than a cell cannot come that close.
#pragma once
#include "state.cuh"

constexpr float SKIN = 0.14f;             // as in flip-sim's neighbours.rs
constexpr float HORIZON = 24.0f;          // longest horizon, substeps
constexpr float PATH_ERROR = 0.002f;      // more than a path as it is kept is off: 0.0015
constexpr float DRIFT_UNIT = 262144.0f;   // the bulk's velocity is added up in whole numbers, too
constexpr int RETRIES = 6;                // half the horizon each time there is no room for all pairs
constexpr int CARRIED = 10;               // room for touching later neighbours of a grain
constexpr int MARKED = 1024;              // added to their number where it does not suffice

// A path in six numbers of 16 bits: its start from the grid's corner in 1/1024 of a diameter, and its
// velocity in 1/32768. A grain outside that range counts as strayed in every substep.
constexpr float START_UNIT = 1024.0f;
constexpr float PACE_UNIT = 32768.0f;

FN Bits start_number(float from_corner) {
    return Bits(within(int(from_corner * START_UNIT + 0.5f), 0, 0xffff));
}

FN Bits pace_number(float v) {
    return Bits(within(int(v * PACE_UNIT + 32768.5f), 0, 0xffff));
}

FN void set_path(const Law& law, Spoon& spoon, int i, Vec x, Vec v) {
    Bits a = start_number(x.x - law.origin[0]), b = start_number(x.y - law.origin[1]);
    Bits c = start_number(x.z - law.origin[2]);
    spoon.path[0][i] = a | b << 16;
    spoon.path[1][i] = c | pace_number(v.x) << 16;
    spoon.path[2][i] = pace_number(v.y) | pace_number(v.z) << 16;
}

// The lower and the upper 16 bits of a word as a float, exactly.
FN float low_half(Bits word) { return float_of(0x4b000000u | (word & 0xffff)) - 8388608.0f; }
FN float high_half(Bits word) { return float_of(0x4b000000u | word >> 16) - 8388608.0f; }

// Where a grain's path is after so many substeps.
FN Vec path_at(const Law& law, const Spoon& spoon, int i, float time) {
    Bits a = spoon.path[0][i], b = spoon.path[1][i], c = spoon.path[2][i];
    float pace = time * (1.0f / PACE_UNIT), back = 32768.0f * pace;
    Vec start = vec(low_half(a), high_half(a), low_half(b));
    Vec way = vec(high_half(b) * pace - back, low_half(c) * pace - back, high_half(c) * pace - back);
    return vec(start.x * (1.0f / START_UNIT) + law.origin[0] + way.x,
               start.y * (1.0f / START_UNIT) + law.origin[1] + way.y,
               start.z * (1.0f / START_UNIT) + law.origin[2] + way.z);
}

struct Cell { int x, y, z; };

FN Cell cell_of(const Law& law, Vec x) {
    float inverse = 1.0f / law.cell;
    return Cell{
        within(int((x.x - law.origin[0]) * inverse), 0, law.size[0] - 1),
        within(int((x.y - law.origin[1]) * inverse), 0, law.size[1] - 1),
        within(int((x.z - law.origin[2]) * inverse), 0, law.size[2] - 1),
    };
}

FN int number_of(const Law& law, Cell c) { return (c.z * law.size[1] + c.y) * law.size[0] + c.x; }

// Sorts the grains by cell and, within a cell, by their old place: `present` and `former`. Returns
// how many there are still. Room for the grid is where the predictions lie.
FN int sort(const Block& block, const Work& work, const Law& law, int grains) {
    int cells = law.size[0] * law.size[1] * law.size[2];
    int* counter = reinterpret_cast<int*>(work.p);
    Place* members = reinterpret_cast<Place*>(counter + CELLS);
    for (int c = block.thread; c < cells; c += block.threads) counter[c] = 0;
    for (int k = block.thread; k < LISTED_LEFT; k += block.threads) work.tally[k] = 0;
    block.barrier();
    int drift[3] = {0, 0, 0};
    for (int i = block.thread; i < grains; i += block.threads) {
        Vec x = load3(work.x, i);
        if (x.x > 0.5f * FAR) continue;
        take_ticket(&counter[number_of(law, cell_of(law, x))], 1);
        Vec v = load3(work.v, i);
        drift[0] += int(v.x * DRIFT_UNIT);
        drift[1] += int(v.y * DRIFT_UNIT);
        drift[2] += int(v.z * DRIFT_UNIT);
    }
    for (int k = 0; k < 3; k++) block.add_up(&work.tally[DRIFT + k], drift[k]);
    block.barrier();
    // Each thread adds up a stretch of cells.
    int stretch = (cells + block.threads - 1) / block.threads;
    int from = least(block.thread * stretch, cells), to = least(from + stretch, cells);
    int sum = 0;
    for (int c = from; c < to; c++) sum += counter[c];
    int start = block.before(sum, work.tally + WARPS);
    for (int c = from; c < to; c++) {
        int count = counter[c];
        work.first[c] = Place(start);
        counter[c] = start;
        start += count;
        if (c == cells - 1) work.first[cells] = Place(start);
    }
    block.barrier();
    for (int i = block.thread; i < grains; i += block.threads) {
        Vec x = load3(work.x, i);
        if (x.x > 0.5f * FAR) continue;
        members[take_ticket(&counter[number_of(law, cell_of(law, x))], 1)] = Place(i);
    }
    block.barrier();
    for (int i = block.thread; i < grains; i += block.threads) {
        Vec x = load3(work.x, i);
        if (x.x > 0.5f * FAR) {
            work.present[i] = NOBODY;
            continue;
        }
        int c = number_of(law, cell_of(law, x)), rank = work.first[c];
        for (int k = work.first[c]; k < work.first[c + 1]; k++) rank += members[k] < i;
        work.present[i] = Place(rank);
        work.former[rank] = Place(i);
    }
    block.barrier();
    return work.first[cells];
}

// While the list is built, `c` holds velocities.
FN float4* velocities(const Work& work) { return reinterpret_cast<float4*>(work.c); }

// And the room of `x` and `v` holds each grain's touching later neighbours: how many, and which. A grain
// with more of them than there is room for is marked: its pairs are noted with the others.
FN int* carried_count(const Work& work) { return reinterpret_cast<int*>(work.x); }
FN Place* carried_place(const Work& work, int i, int k) {
    Place* rest = reinterpret_cast<Place*>(carried_count(work) + GRAINS);
    return k < 6 ? reinterpret_cast<Place*>(work.v) + 6 * i + k : rest + 4 * i + k - 6;
}

// The grains in touch with one grain, packed by twos so that a search need not look them up.
struct Carried {
    Bits pairs[CARRIED / 2];
    int count;
};

FN void remember(Carried& carried, int j) {
#if defined(__CUDACC__)
#pragma unroll
#endif
    for (int k = 0; k < CARRIED / 2; k++) {
        if (k == carried.count >> 1) {
            carried.pairs[k] =
                carried.count & 1 ? (carried.pairs[k] & 0xffff) | Bits(j) << 16 : 0xffff0000u | Bits(j);
        }
    }
    carried.count++;
}

FN bool is_carried(const Carried& carried, int j) {
    Bits twice = Bits(j) | Bits(j) << 16, found = 0;
#if defined(__CUDACC__)
#pragma unroll
#endif
    for (int k = 0; k < CARRIED / 2; k++) {
        Bits difference = carried.pairs[k] ^ twice;
        found |= (difference - 0x00010001u) & ~difference & 0x80008000u;
    }
    return found != 0;
}

// Whether the paths of two grains come closer than `near2` allows.
FN bool approach(Vec r, Vec u, float rr, float near2, float horizon) {
    float ru = dot(r, u), uu = dot(u, u);
    float end = rr + horizon * (ru + ru + horizon * uu);
    float closing = 0.0f - ru;
    bool between = 0.0f < closing && closing < uu * horizon;
    return smaller(rr, end) < near2 || (between && rr * uu - ru * ru < near2 * uu);
}

// Notes the pairs of grains with too many touching later neighbours: with the later one, or where that
// has no room left, with the grain itself. Returns whether there is none there either.
FN bool note_elsewhere(const Block& block, const Work& work, const Memory& now, int grains) {
    for (int i = block.thread; i < grains; i += block.threads) {
        if (carried_count(work)[i] > CARRIED) carried_count(work)[i] = MARKED;
    }
    block.barrier();
    bool crowded = false;
    for (int t = block.thread; t < work.tally[TOUCHING]; t += block.threads) {
        int a = now.touching[t] & 0xffff, b = now.touching[t] >> 16;
        int* count = carried_count(work);
        if (count[least(a, b)] < MARKED) continue;
        int with = most(a, b), k = take_ticket(&count[with], 1);
        k -= k < MARKED ? 0 : MARKED;
        if (k >= CARRIED) with = least(a, b), k = take_ticket(&count[with], 1) - MARKED;
        if (k < CARRIED) {
            *carried_place(work, with, k) = Place(least(a, b) + most(a, b) - with);
        } else {
            crowded = true;
        }
    }
    return block.any(crowded);
}

// Carries the touching pairs over. Returns whether there are more of them in one place than a search can
// keep in mind.
FN bool carry(const Block& block, const Work& work, const Memory& was, Memory& now, int contacts,
              int grains) {
    for (int i = block.thread; i < grains; i += block.threads) carried_count(work)[i] = 0;
    if (block.thread == 0) work.tally[TOUCHING] = 0;
    block.barrier();
    bool crowded = false;
    for (int t = block.thread; t < contacts; t += block.threads) {
        Anchor anchor = was.anchors[t];
        Bits pair = was.touching[t];
        int a = work.present[pair & 0xffff], b = work.present[pair >> 16];
        if (!holds(anchor) || a == NOBODY || b == NOBODY) continue;
        int owner = least(a, b), k = take_ticket(&carried_count(work)[owner], 1);
        if (k < CARRIED) {
            *carried_place(work, owner, k) = Place(most(a, b));
        } else {
            crowded = true;
        }
        int place = take_ticket(&work.tally[TOUCHING], 1);
        now.touching[place] = pair_of(a, b);
        // As the other grain of the pair sees it.
        if (a > b) anchor = reversed(anchor);
#if defined(FLIP_EXTENDED)
        now.anchors[place] = anchor;
        float4 rolls = was.rolls[t];
        now.rolls[place] = with(scale(first3(rolls), a > b ? -1.0f : 1.0f), rolls.w);
#else
        now.anchors[place] = make_uint2(anchor.x, anchor.y | TOUCHES);
#endif
    }
    return block.any(crowded) && note_elsewhere(block, work, now, grains);
}

// Whether the pair of a marked grain and this later one is noted with the latter.
FN bool is_noted(const Work& work, int i, int j) {
    int count = carried_count(work)[j];
    count = least(count < MARKED ? count : count - MARKED, CARRIED);
    for (int k = 0; k < count; k++) {
        if (*carried_place(work, j, k) == Place(i)) return true;
    }
    return false;
}

// A grain that looks for later neighbours.
struct Seeker {
    Vec x, v;
    Carried carried;
    bool is_marked, crowded;
#if defined(FLIP_EXTENDED)
    float reach;                   // 0 where all grains are of one size
#endif
};

// Lists the neighbours among the grains at these places.
FN void search_line(const Work& work, Memory& now, int i, int from, int end, float near2,
                    float horizon, Seeker& me) {
    int most_left = longest(end - from);
    for (; most_left > 0; most_left -= 32, from += 32) {
        Bits hits = 0;
        int count = least(most_left, 32);
        ONE_BY_ONE
        for (int k = 0; k < count; k++) {
            if (from + k < end) {
                Vec r = sub(me.x, first3(work.p[from + k]));
                Vec u = sub(me.v, first3(velocities(work)[from + k]));
#if defined(FLIP_EXTENDED)
                if (me.reach > 0.0f) {
                    float far = me.reach + velocities(work)[from + k].w;
                    near2 = far * far;
                }
#endif
                if (approach(r, u, dot(r, r), near2, horizon)) hits |= 1u << k;
            }
        }
        meet();
        ONE_BY_ONE
        while (longest(hits != 0)) {
            int j = from + lowest(hits);
            if (hits != 0 && !is_carried(me.carried, j) && !(me.is_marked && is_noted(work, i, j))) {
                int place = take_ticket(&work.tally[NEAR], 1);
                if (place < PAIRS) {
                    now.near[place] = pair_of(i, j);
                } else {
                    me.crowded = true;
                }
            }
            hits &= hits - 1;
            meet();
        }
    }
}

// Lists the later neighbours of the grain now at place `i`, or of none; returns whether there is no
// room for them.
FN bool search(const Work& work, const Law& law, Memory& now, int i, bool is_one, float horizon) {
    int touching = carried_count(work)[i];
    bool is_marked = touching >= MARKED;
    touching = least(is_marked ? touching - MARKED : touching, CARRIED);
    Seeker me = Seeker{first3(work.p[i]), first3(velocities(work)[i]), Carried{}, is_marked, false};
    float near = 1.0f + pair_reach(law) + 2.0f * SKIN;
#if defined(FLIP_EXTENDED)
    // Of the grain itself; those of the others come to it.
    me.reach = law.more.widest > RADIUS ? velocities(work)[i].w + pair_reach(law) + 2.0f * SKIN : 0.0f;
#endif
    for (int k = 0; k < CARRIED / 2; k++) me.carried.pairs[k] = 0xffffffffu;
    for (int k = 0; k < touching; k++) remember(me.carried, *carried_place(work, i, k));
    meet();
    Cell at = cell_of(law, me.x);
    int low = most(at.x - 1, 0), high = least(at.x + 1, law.size[0] - 1);
    // The rest of its own line, the next line of its layer, and three lines of the next layer.
    for (int row = 0; row < 5; row++) {
        int y = at.y + (row < 2 ? row : row - 3), z = at.z + (row < 2 ? 0 : 1);
        int from = 0, end = 0;
        if (is_one && y >= 0 && y < law.size[1] && z < law.size[2]) {
            int line = (z * law.size[1] + y) * law.size[0];
            from = row == 0 ? i + 1 : work.first[line + low];
            end = work.first[line + high + 1];
        }
        meet();
        search_line(work, now, i, from, end, near * near, horizon, me);
    }
    return me.crowded;
}

// Sorts the grains and builds the list. Returns the horizon for which it holds.
FN float build(const Block& block, const Work& work, const Law& law, Spoon& spoon, int& grains,
               int& contacts, int& fault) {
    const Memory& was = spoon.memory[spoon.head.generation];
    Memory& now = spoon.memory[1 - spoon.head.generation];
    int before = grains;
    // The grid takes the place of the predictions, which hold the shares of the damping.
    for (int i = block.thread; i < before; i += block.threads) {
        work.c[3 * GRAINS + i] = int(bits_of(work.p[i].w));
    }
    block.barrier();
    grains = sort(block, work, law, before);
    for (int i = block.thread; i < grains; i += block.threads) {
        int old = work.former[i];
        work.p[i] = with(load3(work.x, old), float_of(Bits(work.c[3 * GRAINS + old])));
    }
    block.barrier();
    // The bulk's velocity, so that a spoonful that slides as one is not fast.
    float share = 1.0f / (DRIFT_UNIT * float(most(grains, 1)));
    Vec drift = vec(float(work.tally[DRIFT]) * share, float(work.tally[DRIFT + 1]) * share,
                    float(work.tally[DRIFT + 2]) * share);
    float fastest2 = 0.0f;
    for (int i = block.thread; i < grains; i += block.threads) {
        int old = work.former[i];
        Vec v = load3(work.v, old);
#if defined(FLIP_EXTENDED)
        velocities(work)[i] = with(v, radius_of(work, law, old));
#else
        velocities(work)[i] = with(v, 0.0f);
#endif
        Vec off = sub(v, drift);
        fastest2 = larger(dot(off, off), fastest2);
        now.id[i] = was.id[old];
        Bits touches = was.wall_touches[old];
        now.wall_touches[i] = touches;
        if (touches != 0) now.wall[i] = was.wall[old];
#if defined(FLIP_EXTENDED)
        now.stretch[i] = was.stretch[old];
        // The room of the torques, of which there are none between substeps.
        store3(reinterpret_cast<float*>(work.torque), i, load3(work.spin, old));
#endif
        set_path(law, spoon, i, first3(work.p[i]), v);
    }
    block.raise_to(&work.tally[FASTEST], int(bits_of(fastest2)));
    block.barrier();
    float fastest = root(float_of(Bits(work.tally[FASTEST])));
    float spare = 0.5f * (law.cell - (2.0f * widest_of(law) + pair_reach(law) + 2.0f * SKIN));
    float horizon = smaller(HORIZON, spare / larger(fastest, NEAREST));
    if (carry(block, work, was, now, contacts, grains)) fault = OVERFULL;
    int tries = 0;
    for (bool crowded = true; crowded && tries < RETRIES; tries++) {
        if (tries > 0) horizon *= 0.5f;
        if (block.thread == 0) work.tally[NEAR] = 0;
        block.barrier();
        bool mine = false;
        for (int i = block.thread; block.goes_on(i, grains); i += block.threads) {
            bool is_one = i < grains;
            if (search(work, law, now, is_one ? i : 0, is_one, horizon)) mine = true;
        }
        crowded = block.any(mine);
        if (crowded && tries == RETRIES - 1) fault = OVERFULL;
    }
    for (int i = block.thread; i < grains; i += block.threads) {
        store3(work.x, i, first3(work.p[i]));
        store3(work.v, i, first3(velocities(work)[i]));
#if defined(FLIP_EXTENDED)
        store3(work.spin, i, load3(reinterpret_cast<const float*>(work.torque), i));
        if (law.more.widest > RADIUS) work.radius[i] = velocities(work)[i].w;
#endif
    }
    block.barrier();
#if defined(FLIP_EXTENDED)
    for (int k = block.thread; k < 3 * GRAINS; k += block.threads) work.torque[k] = 0;
#endif
    for (int k = block.thread; k < 4 * GRAINS; k += block.threads) work.c[k] = 0;
    contacts = work.tally[TOUCHING];
    if (block.thread == 0) {
        spoon.head.generation = 1 - spoon.head.generation;
        spoon.head.rebuilds++;
        spoon.head.crowded += tries - 1;
        work.tally[LISTED_LEFT] = 0;
    }
    block.barrier();
    return horizon;
}
