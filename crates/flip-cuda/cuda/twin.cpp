// The same source compiled for a processor: reads jobs from a file, carries them out one after
// another on one thread, and writes what became of them. `src/twin_for_tests.rs` has the format.
#include <cstdio>
#include <cstdlib>
#include <cstddef>
#include <vector>

#include "spoon.cuh"

constexpr size_t IMAGE = offsetof(Spoon, memory) + sizeof(Memory);

template <class T>
std::vector<T> read(FILE* from, size_t count) {
    std::vector<T> all(count);
    if (count && std::fread(all.data(), sizeof(T), count, from) != count) std::exit(2);
    return all;
}

template <class T>
void write(FILE* to, const T* all, size_t count) {
    if (count && std::fwrite(all, sizeof(T), count, to) != count) std::exit(3);
}

int main(int count, char** arguments) {
    if (count != 3) return 1;
    FILE* from = std::fopen(arguments[1], "rb");
    FILE* to = std::fopen(arguments[2], "wb");
    if (!from || !to) return 1;
    auto counts = read<int>(from, 6);
    auto laws = read<Law>(from, counts[0]);
    std::vector<Spoon> spoons(counts[1]);
    for (auto& spoon : spoons) {
        if (std::fread(&spoon, IMAGE, 1, from) != 1) return 2;
    }
    auto jobs = read<Job>(from, counts[2]);
    auto parts = read<Part>(from, counts[3]);
    auto bodies = read<float2>(from, counts[4]);
    auto added = read<Added>(from, counts[5]);
    std::vector<float4> p(GRAINS);
    std::vector<int4> sums(GRAINS);
    std::vector<float> x(3 * GRAINS), v(3 * GRAINS);
    std::vector<Place> first(CELLS + 1), present(GRAINS), former(GRAINS);
    std::vector<int> tally(TALLIES), rests(parts.size());
    std::vector<Outcome> outcomes(jobs.size());
    std::vector<Departed> departed(size_t(GRAINS) * jobs.size());
    int lost = 0;
    Work work = {p.data(), &sums[0].x, x.data(), v.data(), first.data(), present.data(),
                 former.data(), tally.data()};
#if defined(FLIP_EXTENDED)
    std::vector<float> spin(3 * GRAINS);
    std::vector<int> torque(3 * GRAINS);
    work.spin = spin.data();
    work.torque = torque.data();
#endif
    for (const Job& job : jobs) {
#if defined(FLIP_EXTENDED)
        work.radius = spoons[job.spoon].radius;
#endif
        work_on(Block{0, 1}, work, laws[job.law], spoons[job.spoon], job, parts.data(),
                bodies.data(), added.data(), rests.data(), Losses{&lost, departed.data()},
                outcomes[job.place]);
    }
    for (auto& spoon : spoons) {
        int present_memory = spoon.head.generation;
        spoon.head.generation = 0;
        write(to, reinterpret_cast<const char*>(&spoon), offsetof(Spoon, memory));
        write(to, &spoon.memory[present_memory], 1);
    }
    write(to, outcomes.data(), outcomes.size());
    write(to, rests.data(), rests.size());
    write(to, &lost, 1);
    write(to, departed.data(), lost);
    return std::fclose(to) == 0 ? 0 : 3;
}
