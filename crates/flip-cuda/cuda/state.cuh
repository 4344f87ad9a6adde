// Where everything of one spoon lies in memory. `src/layout.rs` has the same numbers.
#pragma once
#include "law.cuh"

constexpr int GRAINS = 2560;       // room for grains
constexpr int SLOTS = 32;          // room for neighbours of a grain
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
    int crowded;                   // lists built again because a grain had too many neighbours
    int unused[25];
};

// What a grain remembers besides its motion. Two of them take turns: a list is built from the
// other's.
struct Memory {
    float4 wall[GRAINS];           // where its contact with the spoon stuck; 1 while it touches
    unsigned id[GRAINS];
    Bits count[GRAINS];            // as `Count`
    Place slots[SLOTS][GRAINS];    // neighbours that come later in the arrays, so that each pair is
                                   // listed once: touching ones, then near ones, from the first
                                   // slot up; those that may come near from the last down
    uint2 anchors[SLOTS][GRAINS];
};

struct Spoon {
    Head head;
    float4 x[GRAINS];              // centre; share of the damping
    float4 v[GRAINS];
    Memory memory[2];
    Bits path[3][GRAINS];          // each grain's since the list was built, as `Path`
};

// A grain's contacts: neighbours that touch, those and near ones, those that may come near, and
// whether the spoon touches.
struct Count {
    int touching, near, later;
    bool wall;
};

FN Count unpack_count(Bits count) {
    return Count{int(count & 0xff), int(count >> 8 & 0xff), int(count >> 16 & 0xff),
                 (count >> 31) != 0};
}

FN Bits pack_count(const Count& count) {
    return Bits(count.touching) | Bits(count.near) << 8 | Bits(count.later) << 16
        | Bits(count.wall) << 31;
}

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
};

struct Outcome {
    int left;                      // grains that left
    int fault;
    int substeps;
    int rebuilds;
    int kept;                      // grains still in the spoon
    int crowded;
    int unused[2];
};

struct Departed {
    int place;                     // of its job's outcome
    int part;
    int substep;                   // of the part's motion; -1 during its rest
    float x[3], v[3];
};

// The grains that left, of all jobs, in no particular order.
struct Losses {
    int* count;
    Departed* list;
};

// A block's working memory. `p` and `c` serve as room for the grid while a list is built.
struct Work {
    float4* p;                     // predicted centre; share of the damping
    int4* c;                       // sum of corrections, fixed point; number of contacts
    float* x;                      // centres, three numbers each
    float* v;                      // velocities, three numbers each
    Place* first;                  // start of each cell's grains, and one more
    Place* present;                // new place of each old place
    Place* former;                 // old place of each new place
    int* tally;                    // counters shared by the block
};

// Counters of a block.
enum Tally { DRIFT = 0, FASTEST = 3, LISTED_LEFT = 4, LEFT = 5, WARPS = 8, TALLIES = 40 };

// Corrections are added up as whole numbers, whose sum does not depend on their order: 2e-9 diameters.
constexpr float CORRECTION_UNIT = 536870912.0f;  // 2^29: up to 4 diameters to both sides

FN Vec correction_of(int4 c) {
    return vec(float(c.x) * (1.0f / CORRECTION_UNIT), float(c.y) * (1.0f / CORRECTION_UNIT),
               float(c.z) * (1.0f / CORRECTION_UNIT));
}

FN Vec load3(const float* from, int i) { return vec(from[3 * i], from[3 * i + 1], from[3 * i + 2]); }
FN void store3(float* to, int i, Vec a) {
    to[3 * i] = a.x;
    to[3 * i + 1] = a.y;
    to[3 * i + 2] = a.z;
}
FN Vec first3(float4 a) { return vec(a.x, a.y, a.z); }
FN float4 with(Vec a, float w) { return make_float4(a.x, a.y, a.z, w); }
