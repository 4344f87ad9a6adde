// The kernels: a block for each job, in the order given. `flip_spoons` needs 162 KB of shared memory,
// 223 KB where grains turn, `flip_spoons_small` 87 KB; it keeps the rest in a room of its own in the
// card's memory.
#include "spoon.cuh"

// Bytes of `c` and `x`, and of `spin` and `torque`.
constexpr int ROOM = (EXTENDED ? 13 : 7) * 4 * GRAINS;

template <bool SMALL>
FN void spoons(const Job* jobs, const Law* laws, Spoon* all, const Part* parts,
               const float2* bodies, const Added* added, int* rests, int* lost, Departed* departed,
               Outcome* outcomes, char* room) {
    extern __shared__ float4 shared[];
    __shared__ int tally[TALLIES];
    __shared__ Law law;
    __shared__ volatile unsigned begin;
    Job job = jobs[blockIdx.x];
    Block block = Block{int(threadIdx.x), int(blockDim.x)};
    if (block.thread == 0) {
        law = laws[job.law];
        begin = unsigned(__cvta_generic_to_shared(shared));
    }
    block.barrier();
    // Read back, the address is a number that the compiler keeps in a register; otherwise it asks a
    // special register for it before every access.
    float4* base = reinterpret_cast<float4*>(__cvta_shared_to_generic(begin));
    Work work;
    work.p = base;
    float* rest = reinterpret_cast<float*>(base + GRAINS);
    work.v = rest;
    rest += 3 * GRAINS;
    if (SMALL) {
        char* mine = room + size_t(ROOM) * blockIdx.x;
        work.c = reinterpret_cast<int*>(mine);
        work.x = reinterpret_cast<float*>(mine + 4 * 4 * GRAINS);
#if defined(FLIP_EXTENDED)
        work.spin = work.x + 3 * GRAINS;
        work.torque = reinterpret_cast<int*>(work.spin + 3 * GRAINS);
#endif
    } else {
        work.c = reinterpret_cast<int*>(rest);
        work.x = rest + 4 * GRAINS;
        rest += 7 * GRAINS;
#if defined(FLIP_EXTENDED)
        work.spin = rest;
        work.torque = reinterpret_cast<int*>(rest + 3 * GRAINS);
        rest += 6 * GRAINS;
#endif
    }
#if defined(FLIP_EXTENDED)
    work.radius = all[job.spoon].radius;
#endif
    work.present = reinterpret_cast<Place*>(rest);
    work.former = work.present + GRAINS;
    work.first = work.former + GRAINS;
    work.tally = tally;
    work_on(block, work, law, all[job.spoon], job, parts, bodies, added, rests,
            Losses{lost, departed}, outcomes[job.place]);
}

#define PARAMETERS \
    const Job *jobs, const Law *laws, Spoon *all, const Part *parts, const float2 *bodies, \
        const Added *added, int *rests, int *lost, Departed *departed, Outcome *outcomes, char *room
#define ARGUMENTS jobs, laws, all, parts, bodies, added, rests, lost, departed, outcomes, room

extern "C" __global__ void __launch_bounds__(896, 1) flip_spoons(PARAMETERS) {
    spoons<false>(ARGUMENTS);
}

extern "C" __global__ void __launch_bounds__(896, 1) flip_spoons_small(PARAMETERS) {
    spoons<true>(ARGUMENTS);
}
