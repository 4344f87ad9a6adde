// The same source compiled for a processor, as a program that reads trainings and batches from a file
// and writes what became of them. `src/learner_twin_for_tests.rs` has the format.
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "learner_steps.cuh"

template <class T>
std::vector<T> read(FILE* from, size_t count) {
    std::vector<T> all(count);
    if (count && std::fread(all.data(), sizeof(T), count, from) != count) std::exit(2);
    return all;
}

int main(int count, char** arguments) {
    if (count != 3) return 1;
    FILE* from = std::fopen(arguments[1], "rb");
    FILE* to = std::fopen(arguments[2], "wb");
    if (!from || !to) return 1;
    Sizes s = read<Sizes>(from, 1)[0];
    size_t trainings = size_t(read<int>(from, 1)[0]), length;
    training_at(nullptr, s, &length);
    auto states = read<float>(from, trainings * length);
    auto drawn = read<float>(from, trainings * s.updates * drawn_length(s));
    auto scales = read<float>(from, trainings * s.updates * SCALES);
    std::vector<double> losses(trainings * s.updates * LOSSES);
    std::vector<float4> room(shared_length(s) / 4 + 1);
    Shared shared = shared_at(&room[0].x, s);
    Block b = Block{0, 1};
    for (size_t group = 0; group < trainings; group++) {
        float* training = states.data() + group * length;
        turn(b, all_of(s, training, drawn.data()));
        for (int update = 0; update < s.updates; update++) {
            size_t place = group * s.updates + update;
            All all = all_of(s, training, drawn.data() + place * drawn_length(s));
            for (int which = 0; which < 4; which++)
                for (int block = 0; block < s.blocks; block++) {
                    stage(b, shared, all, which, block, scales.data() + place * SCALES, losses.data() + place * LOSSES);
                }
        }
    }
    std::fwrite(states.data(), sizeof(float), states.size(), to);
    std::fwrite(losses.data(), sizeof(double), losses.size(), to);
    return std::fclose(to) == 0 ? 0 : 3;
}
