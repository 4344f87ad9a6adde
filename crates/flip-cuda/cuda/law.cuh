// The laws of one contact: the text of flip-sim's lib.rs and constraints.rs. Lengths in grain
// diameters, time in substeps.
#pragma once
#include "platform.cuh"

// What this build computes: spoonfuls, or heaps on a round base, into which grains are poured.
#if defined(FLIP_HEAPS)
constexpr bool HEAPS = true;
#else
constexpr bool HEAPS = false;
#endif

// The base simulator, or grains that turn, with the mechanisms of `Mechanisms`.
#if defined(FLIP_EXTENDED)
constexpr bool EXTENDED = true;
#else
constexpr bool EXTENDED = false;
#endif

// One kind of contact; shares are of one substep and one side.
struct Strengths {
    // Of an overlap and of an approach velocity. The dampings of pairs are multiplied by the drag,
    // because they are applied to velocities before it.
    float normal, normal_damping;
    float tangential, looseness;           // share of a stretch, and its inverse
    float tangential_damping, friction;    // share of a slip velocity, Coulomb's coefficient
    float attraction, inverse_ramp;        // of touching bodies; 1 / (reach - onset)
    float onset, reach;                    // gaps at which touch begins and attraction ends
};

#if defined(FLIP_EXTENDED)
// Mechanisms beyond the base simulator: the text of flip-sim's mechanisms. One of strength 0 does
// nothing.
struct Mechanisms {
    float ease;                            // change of spin per torque over mass
    float rolling;                         // largest rolling torque over push and radius
    float stiffness, damping;              // shares of a rolling stretch, and of a turn
    float film, cling;                     // pull of the spoon, and more of it for a grain that clings
    float film_ramp;                       // 1 / reach of that pull
    float charge, charge_reach;            // pull of a wall at contact, and the gap at which it ends
    float ageing, half_life;               // pull of an old contact; age at which it is half of that
    float bridge, rupture;                 // pull of a liquid bridge at contact; gap at which it breaks
    float inverse_length;                  // 1 / length over which its pull falls
    float air, inertia;                    // share of a slow velocity that air takes; more by its size
    float vibration;                       // peak acceleration of the spoon
    float widest;                          // largest radius; 1/2 where all grains are of one size
    Bits pace;                             // turns of the vibration a substep, in 2^-32
};
#endif

// A powder, its spoon and the grid over it; as `Law` in src/layout.rs.
struct Law {
    Strengths grain, wall;
    float drag;                            // factor on every velocity
    float inverse_squares[3];              // of the bowl's semi-axes
    float deep;                            // the bowl's depth
    float clear_bowl, clear_rim;           // shape functions below which the wall is out of reach
    float rest_speed2;                     // squared speed below which all grains rest
    int quiet, slice;                      // substeps of rest; substeps between two checks
    float origin[3];                       // the grid's corner
    float cell;                            // side of its cells
    int size[3];                           // cells along each axis
    float plate;                           // radius of a heap's base
#if defined(FLIP_EXTENDED)
    Mechanisms more;
#endif
};

// Gap at which grains begin to act on one another.
FN float pair_reach(const Law& law) {
#if defined(FLIP_EXTENDED)
    return larger(law.grain.reach, law.more.rupture);
#else
    return law.grain.reach;
#endif
}

constexpr float RADIUS = 0.5f;

FN float widest_of(const Law& law) {
#if defined(FLIP_EXTENDED)
    return law.more.widest;
#else
    return RADIUS;
#endif
}

constexpr float NEAREST = 1e-6f;           // lower limit of distances
constexpr float NEVER = 3.0e38f;           // a gap that is never closed

// push = max(0, -k C - c u): reverses an overlap and slows an approach; never a pull.
FN float separate(float gap, float opening, float stiffness, float damping) {
    return larger(0.0f, stiffness * (0.0f - gap) - damping * opening);
}

// pull = b up to the onset, then a ramp that ends at the reach.
FN float attract(float gap, const Strengths& c) {
    return c.attraction * larger(0.0f, 1.0f - larger(0.0f, gap) * c.inverse_ramp);
}

// What friction does to a contact.
struct Held {
    Vec correction;  // of the first body, to be subtracted
    Vec anchor;
    bool slips;
};

// Tangential correction from the stretch since the contact last stuck, up to Coulomb's limit; a
// contact that slips takes its anchor along, so that the next substep starts at the limit. Stretch
// and slip velocity are weighed first and freed of their normal part together.
FN Held stick(Vec offset, Vec anchor, Vec velocity, Vec normal, float damping, float limit,
              const Strengths& c) {
    Vec pull = add(scale(sub(offset, anchor), c.tangential), scale(velocity, damping));
    Vec t = sub(pull, scale(normal, dot(pull, normal)));
    float t2 = dot(t, t);
    if (!(limit * limit < t2)) return Held{t, anchor, false};
    t = scale(t, limit * inverse_root(t2));
    return Held{t, sub(offset, scale(t, c.looseness)), true};
}

// The nearest point of the spoon.
struct Touch {
    float gap;
    Vec normal;
};

// Inside, the distance to the ellipsoid is first order; above it only the rim can be touched.
FN Touch bowl(const Law& law, Vec p) {
    const float* inverse = law.inverse_squares;
    float level = p.x * p.x * inverse[0] + p.y * p.y * inverse[1];
    float f2 = level + p.z * p.z * inverse[2];
    if (p.z < 0.0f ? f2 < law.clear_bowl : level < law.clear_rim) {
        return Touch{NEVER, vec(0.0f, 0.0f, 1.0f)};
    }
    if (p.z < 0.0f && f2 < 1.0f) {
        Vec gradient = vec(p.x * inverse[0], p.y * inverse[1], p.z * inverse[2]);
        float steepness = larger(root(dot(gradient, gradient)), NEAREST);
        float f = root(f2);
        float gap = f2 < 0.01f ? law.deep : f * (1.0f - f) / steepness - RADIUS;
        return Touch{gap, scale(gradient, -1.0f / steepness)};
    }
    float to_rim = 1.0f / larger(root(level), NEAREST);
    Vec away = sub(p, vec(p.x * to_rim, p.y * to_rim, 0.0f));
    float distance = larger(root(dot(away, away)), NEAREST);
    float gap = level < 0.25f ? NEVER : distance - RADIUS;
    return Touch{gap, scale(away, 1.0f / distance)};
}

// A horizontal round base at height 0 with a sharp rim. A cohesive grain can crawl around the rim: below
// the base it touches the underside.
FN Touch plate(const Law& law, Vec p) {
    float level = p.x * p.x + p.y * p.y;
    if (level < law.plate * law.plate) {
        float side = p.z < -0.25f ? -1.0f : 1.0f;
        return Touch{side * p.z - RADIUS, vec(0.0f, 0.0f, side)};
    }
    float to_rim = law.plate / larger(root(level), NEAREST);
    Vec away = sub(p, vec(p.x * to_rim, p.y * to_rim, 0.0f));
    float distance = larger(root(dot(away, away)), NEAREST);
    return Touch{distance - RADIUS, scale(away, 1.0f / distance)};
}

FN Touch nearest(const Law& law, Vec p) { return HEAPS ? plate(law, p) : bowl(law, p); }

// Whether a grain centred at `p` has left the spoon or the base for good.
FN bool has_left(const Law& law, Vec p) {
    if (HEAPS) return p.z < -1.0f;
    float f2 = p.x * p.x * law.inverse_squares[0] + p.y * p.y * law.inverse_squares[1]
        + p.z * p.z * law.inverse_squares[2];
    return p.z < -1.5f && f2 > 1.0f;
}

// Share of the damping of a grain with so many contacts.
FN float share_of(float contacts) { return inverse_root(larger(1.0f, contacts)); }

// Anchors of pairs are kept as three fixed-point numbers of 21 bits: 1.9e-6 diameters, what a float
// resolves beyond 16 diameters. The rounding is the same for both signs, so both grains of a pair
// keep exactly opposite anchors. The range is 2 to both sides, which only contacts that slip at
// metres per second leave; what they remember then is limited by Coulomb's law like anything else.
constexpr float ANCHOR_SCALE = 524288.0f;  // 2^19: products with it are exact
constexpr float ANCHOR_ZERO = 9437184.0f;  // 2^23 + 2^20: the lowest 21 bits are the number
constexpr Bits ANCHOR_BITS = 0x1fffff;

FN Bits pack_one(float a) { return bits_of(a * ANCHOR_SCALE + ANCHOR_ZERO) & ANCHOR_BITS; }

FN uint2 pack(Vec a) {
    Bits x = pack_one(a.x), y = pack_one(a.y), z = pack_one(a.z);
    return make_uint2(x | y << 21, y >> 11 | z << 10);
}

FN float unpack_one(Bits number) {
    return float_of(0x4b000000u | (number & ANCHOR_BITS)) * (1.0f / ANCHOR_SCALE)
        - ANCHOR_ZERO / ANCHOR_SCALE;
}

FN Vec unpack(uint2 a) {
    return vec(unpack_one(a.x), unpack_one(a.x >> 21 | a.y << 11), unpack_one(a.y >> 10));
}

constexpr Bits TOUCHES = 0x80000000;       // in the second word of an anchor: the pair touches now

// What a listed pair remembers: where it stuck, and whether it touches now. Turning surfaces carry the
// anchor along, by less than the fixed point resolves, so that with them it is a float.
#if defined(FLIP_EXTENDED)
typedef float4 Anchor;
FN Anchor stuck_at(Vec a) { return make_float4(a.x, a.y, a.z, 1.0f); }
FN Vec place_of(Anchor a) { return vec(a.x, a.y, a.z); }
constexpr float BRIDGED = 2.0f;            // in the fourth place: only a liquid bridge is left of it
FN bool touches(Anchor a) { return a.w == 1.0f; }
FN bool holds(Anchor a) { return a.w != 0.0f; }
FN Anchor reversed(Anchor a) { return with(scale(place_of(a), -1.0f), a.w); }
FN Anchor nothing() { return make_float4(0.0f, 0.0f, 0.0f, 0.0f); }
#else
typedef uint2 Anchor;
FN Anchor stuck_at(Vec a) {
    uint2 packed = pack(a);
    return make_uint2(packed.x, packed.y | TOUCHES);
}
FN Vec place_of(Anchor a) { return unpack(a); }
FN bool touches(Anchor a) { return (a.y & TOUCHES) != 0; }
FN bool holds(Anchor a) { return touches(a); }
FN void let_go(Anchor& to, Anchor was) { to.y = was.y & ~TOUCHES; }
FN Anchor reversed(Anchor a) { return pack(scale(unpack(a), -1.0f)); }
FN Anchor nothing() { return make_uint2(0, 0); }
#endif

#if defined(FLIP_EXTENDED)
// What resists the turning of two bodies in contact.
struct Rolled {
    Vec torque;  // of the first body, to be subtracted
    Vec stretch;
};

// An elastic spring with a slider, as friction. `side` is the reduced mass of two grains, twice over,
// and 2 at a wall, which does not yield.
FN Rolled resist(const Mechanisms& m, Vec stretch, Vec turning, float radius, float side, float push) {
    if (m.rolling == 0.0f) return Rolled{vec(0.0f, 0.0f, 0.0f), vec(0.0f, 0.0f, 0.0f)};
    Vec s = add(stretch, turning);
    float r2 = radius * radius * side, k = m.stiffness * r2, c = m.damping * r2;
    Vec torque = add(scale(s, k), scale(turning, c));
    float limit = m.rolling * radius * push, size2 = dot(torque, torque);
    if (!(limit * limit < size2)) return Rolled{torque, s};
    torque = scale(torque, limit * inverse_root(size2));
    return Rolled{torque, scale(torque, 1.0f / k)};
}

// Pull of a contact of this age, which grows and saturates.
FN float aged(const Mechanisms& m, float age) { return m.ageing * over(age, age + m.half_life); }

// Pull of a liquid bridge.
FN float bridged(const Mechanisms& m, float gap) {
    float s = larger(0.0f, gap) * m.inverse_length;
    return over(m.bridge, 1.0f + s * (1.05f + 2.5f * s));
}

// A velocity after the drag of air, taken implicitly.
FN Vec slowed(const Mechanisms& m, Vec u, float radius) {
    if (m.air == 0.0f) return u;
    float smallness = radius == RADIUS ? 1.0f : RADIUS / radius;
    float reynolds = m.inertia * root(dot(u, u)) / smallness;
    float rate = m.air * smallness * smallness * (1.0f + reynolds);
    return scale(u, over(1.0f, 1.0f + rate));
}

// Mass over that of a mean grain.
FN float mass_of(float radius) {
    float diameter = radius + radius;
    return diameter * diameter * diameter;
}

// What the sizes of two grains in contact change.
struct Sizes {
    float lever;                           // share of the distance on the first one's side
    float reduced;                         // twice the reduced mass
    float effective;                       // diameter, with which attraction grows
    float rolling;                         // radius
};

FN Sizes sizes_of(float a, float b) {
    if (a == RADIUS && b == RADIUS) return Sizes{0.5f, 1.0f, 1.0f, RADIUS};
    float mine = mass_of(a), theirs = mass_of(b);
    return Sizes{a / (a + b), (mine + mine) * theirs / (mine + theirs), 4.0f * a * b / (a + b),
                 (a + a) * b / (a + b)};
}

// The sine of a phase in 2^-32 of a turn, by its series about the nearest zero.
FN float sine(Bits phase) {
    float turn = float(int(phase)) * (1.0f / 4294967296.0f);
    if (turn > 0.25f) turn = 0.5f - turn;
    if (turn < -0.25f) turn = -0.5f - turn;
    float y = 6.28318531f * turn, y2 = y * y;
    float tail = 1.0f - y2 * (1.0f / 72.0f) * (1.0f - y2 * (1.0f / 110.0f));
    return y * (1.0f - y2 * (1.0f / 6.0f) * (1.0f - y2 * (1.0f / 20.0f) * (1.0f - y2 * (1.0f / 42.0f) * tail)));
}

// What the vibration of the spoon adds to the acceleration along z in this substep.
FN float shaken(const Mechanisms& m, int substep) {
    return m.vibration == 0.0f ? 0.0f : 0.0f - m.vibration * sine(Bits(substep) * m.pace);
}

// Pulls of the spoon beside its adhesion.
FN float attract_more(float gap, float radius, float clings, const Mechanisms& m) {
    float above = larger(0.0f, gap);
    float film = (m.film + m.cling * clings) * larger(0.0f, 1.0f - above * m.film_ramp);
    float share = over(radius, radius + above);
    return film + (gap < m.charge_reach ? m.charge * share * share : 0.0f);
}
#endif
