// The kernel: `blocks` blocks for each training, all of them on the card at once.
#include "learner_steps.cuh"

// Waits until every block of the group is here. What the others wrote before is then seen: the fence
// empties this processor's own cache.
FN void meet_group(volatile unsigned* count, unsigned blocks, unsigned* turn) {
    __syncthreads();
    if (threadIdx.x == 0) {
        *turn += blocks;
        __threadfence();
        atomicAdd(const_cast<unsigned*>(count), 1u);
        while (int(*count - *turn) < 0) {}
        __threadfence();
    }
    __syncthreads();
}

extern "C" __global__ void __launch_bounds__(512, 1)
flip_learners(Sizes s, float* trainings, const float* drawn, const float* scales, double* losses, unsigned* counts) {
    extern __shared__ float room[];
    __shared__ All all;
    Shared shared = shared_at(room, s);
    Block b = Block{int(threadIdx.x), int(blockDim.x)};
    int group = blockIdx.x / s.blocks, block = blockIdx.x % s.blocks;
    size_t length;
    training_at(nullptr, s, &length);
    float* training = trainings + group * length;
    unsigned turn_number = 0;
    unsigned* count = counts + group;
    if (b.thread == 0) all = all_of(s, training, drawn);
    __syncthreads();
    if (block == 0) turn(b, all);
    meet_group(count, s.blocks, &turn_number);
    for (int update = 0; update < s.updates; update++) {
        size_t place = size_t(group) * s.updates + update;
        if (b.thread == 0) all = all_of(s, training, drawn + place * drawn_length(s));
        __syncthreads();
        for (int which = 0; which < 4; which++) {
            stage(b, shared, all, which, block, scales + place * SCALES, losses + place * LOSSES);
            meet_group(count, s.blocks, &turn_number);
        }
    }
}
