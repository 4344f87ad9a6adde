// Where everything of one spoon lies in memory. `src/layout.rs` has the same numbers.
#pragma once
#include "law.cuh"

constexpr int GRAINS = 2560;       // room for grains
constexpr int CONTACTS = 16384;    // room for pairs that touch
constexpr int PAIRS = 16384;       // room for other pairs
constexpr Bits NO_PAIR = 0xffffffff;
constexpr int CELLS = 4096;        // room for cells of the grid
constexpr Place NOBODY = 0xffff;
constexpr float FAR = 1.0e6f;      // coordinate of a grain that has left

// Reasons to give a spoon up.
enum Fault { NONE = 0, TOO_FAST = 1, OVERFULL = 2 };

struct Head {
    int grains;                    // places in use, with grains that left since the last list
    int left;                      // grains among them that left
    int generation;                // which of the two memories is the present one
    int fault;
    int rebuilds;                  // lists built since the spoon was filled
    int substeps;                  // substeps since then
    int crowded;                   // lists built again because they had no room for all pairs
    int contacts;                  // pairs listed as touching
    int elapsed;                   // substeps before the spoon was filled
    int unused[23];
};

// What a grain remembers besides its motion. Two of them take turns: a list is built from the
// other's.
struct Memory {
    float4 wall[GRAINS];           // where its contact with the spoon stuck
#if defined(FLIP_EXTENDED)
    float4 stretch[GRAINS];        // of its rolling there; 1 for a grain that clings
#endif
    unsigned id[GRAINS];
    Bits wall_touches[GRAINS];     // whether it touches now
    // Every pair is listed once: the grain that comes first in the arrays, and the other one << 16.
    Bits touching[CONTACTS];       // pairs that touch, and some that no longer do
    Anchor anchors[CONTACTS];      // of those
#if defined(FLIP_EXTENDED)
    float4 rolls[CONTACTS];        // of those: the stretch of their rolling; age, substeps
#endif
    Bits near[PAIRS];              // pairs that may come to touch before the next list, or NO_PAIR
};

struct Spoon {
    Head head;
    float4 x[GRAINS];              // centre; share of the damping
    float4 v[GRAINS];
#if defined(FLIP_EXTENDED)
    float4 spin[GRAINS];           // radians per substep
    float radius[GRAINS];
#endif
    Memory memory[2];
    Bits path[3][GRAINS];          // each grain's since the list was built: see list.cuh
};

// A motion of the spoon, then rest.
struct Part {
    int first, substeps;           // of the motion, in the table of accelerations
    int rest_max;                  // most substeps of rest after it
    float standing[2];             // acceleration along x and z during the rest
};

// What one block has to do.
struct Job {
    int spoon, law;                // places in the tables of spoons and laws
    int first, parts;              // parts of the plan
    int place;                     // of its outcome
    int added, count;              // grains that are poured first, in their table
};

// A grain that is poured.
struct Added {
    float x[3], v[3];
    unsigned id;
#if defined(FLIP_EXTENDED)
    float radius;
#endif
};

struct Outcome {
    int left;                      // grains that left
    int fault;
    int substeps;
    int rebuilds;
    int kept;                      // grains still in the spoon
    int crowded;
    int places;                    // as `Head::grains`
    float apex;                    // height of the highest grain that touches two others or more
    Bits speeds[2];                // sum of the squared speeds: lower 20 of 40 bits, and upper
};

struct Departed {
    int place;                     // of its job's outcome
    int part;
    int substep;                   // of the part's motion; -1 during its rest
    float x[3], v[3];
#if defined(FLIP_EXTENDED)
    unsigned id;
#endif
};

// The grains that left, of all jobs, in no particular order.
struct Losses {
    int* count;
    Departed* list;
};

// A block's working memory. All of it but `tally` serves other ends while a list is built.
struct Work {
    float4* p;                     // predicted centre; share of the damping
    int* c;                        // sum of corrections, fixed point: all x, all y, all z; then
                                   // numbers of contacts
    float* x;                      // centres, three numbers each
    float* v;                      // velocities, three numbers each
    Place* first;                  // start of each cell's grains, and one more
    Place* present;                // new place of each old place
    Place* former;                 // old place of each new place
    int* tally;                    // counters shared by the block
#if defined(FLIP_EXTENDED)
    float* spin;                   // three numbers each
    int* torque;                   // sum of torques, fixed point: all x, all y, all z
    float* radius;                 // in the card's memory
#endif
};

#if defined(FLIP_EXTENDED)
FN float radius_of(const Work& work, const Law& law, int i) {
    return law.more.widest > RADIUS ? work.radius[i] : RADIUS;
}
#endif

// Counters of a block.
enum Tally {
    DRIFT = 0, FASTEST = 3, LISTED_LEFT = 4, LEFT = 5, TOUCHING = 6, NEAR = 7, WARPS = 8, TALLIES = 40
};

// Corrections are added up as whole numbers, whose sum does not depend on their order: 2e-9 diameters.
constexpr float CORRECTION_UNIT = 536870912.0f;  // 2^29: up to 4 diameters to both sides

FN Vec correction_of(int4 c) {
    return vec(float(c.x) * (1.0f / CORRECTION_UNIT), float(c.y) * (1.0f / CORRECTION_UNIT),
               float(c.z) * (1.0f / CORRECTION_UNIT));
}

FN Bits pair_of(int a, int b) { return Bits(least(a, b)) | Bits(most(a, b)) << 16; }

FN Vec load3(const float* from, int i) { return vec(from[3 * i], from[3 * i + 1], from[3 * i + 2]); }
FN void store3(float* to, int i, Vec a) {
    to[3 * i] = a.x;
    to[3 * i + 1] = a.y;
    to[3 * i + 2] = a.z;
}
