// What differs between a card and a processor, so that the same physics compiles for both.
//
// On a card a block of threads carries out one spoon, each thread every `threads`-th grain. On a
// processor one thread does it all, and every barrier between threads is nothing. What several threads
// add up is whole numbers, so the results do not depend on the number or the order of threads.
#pragma once

#if defined(__CUDACC__)
#define FN __device__ __forceinline__
#define ONE_BY_ONE _Pragma("unroll 1")
#else
#include <cmath>
#include <cstring>
#define FN inline
#define ONE_BY_ONE
struct float2 { float x, y; };
struct alignas(16) float4 { float x, y, z, w; };
struct alignas(8) uint2 { unsigned x, y; };
struct alignas(16) int4 { int x, y, z, w; };
inline int4 make_int4(int x, int y, int z, int w) { return {x, y, z, w}; }
inline float2 make_float2(float x, float y) { return {x, y}; }
inline float4 make_float4(float x, float y, float z, float w) { return {x, y, z, w}; }
inline uint2 make_uint2(unsigned x, unsigned y) { return {x, y}; }
#endif

typedef unsigned short Place;  // a grain's place in the arrays
typedef unsigned int Bits;

struct Vec { float x, y, z; };

FN Vec vec(float x, float y, float z) { return Vec{x, y, z}; }
FN Vec add(Vec a, Vec b) { return vec(a.x + b.x, a.y + b.y, a.z + b.z); }
FN Vec sub(Vec a, Vec b) { return vec(a.x - b.x, a.y - b.y, a.z - b.z); }
FN Vec scale(Vec a, float k) { return vec(a.x * k, a.y * k, a.z * k); }
FN Vec cross(Vec a, Vec b) {
    return vec(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
FN float dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
FN Vec first3(float4 a) { return vec(a.x, a.y, a.z); }
FN float4 with(Vec a, float w) { return make_float4(a.x, a.y, a.z, w); }
#if defined(__CUDACC__)
FN float larger(float a, float b) { return fmaxf(a, b); }
FN float smaller(float a, float b) { return fminf(a, b); }
#else
FN float larger(float a, float b) { return a > b ? a : b; }
FN float smaller(float a, float b) { return a < b ? a : b; }
#endif
FN int least(int a, int b) { return a < b ? a : b; }
FN int most(int a, int b) { return a > b ? a : b; }
FN int within(int x, int low, int high) { return least(most(x, low), high); }

#if defined(__CUDACC__)
FN float root(float x) { return sqrtf(x); }
#if defined(FLIP_EXACT)
FN float inverse_root(float x) { return 1.0f / sqrtf(x); }
FN float over(float a, float b) { return a / b; }
#else
FN float inverse_root(float x) { return rsqrtf(x); }
FN float over(float a, float b) { return __fdividef(a, b); }
#endif
FN Bits bits_of(float x) { return __float_as_uint(x); }
FN float float_of(Bits x) { return __uint_as_float(x); }
FN int lowest(Bits x) { return __ffs(x) - 1; }
FN int rounded(float x) { return __float2int_rn(x); }
FN int take_ticket(int* counter, int by) { return atomicAdd(counter, by); }
FN void raise(int* to, int value) { atomicMax(to, value); }
#else
FN float root(float x) { return std::sqrt(x); }
FN float inverse_root(float x) { return 1.0f / std::sqrt(x); }
FN float over(float a, float b) { return a / b; }
FN Bits bits_of(float x) { Bits b; std::memcpy(&b, &x, 4); return b; }
FN float float_of(Bits b) { float x; std::memcpy(&x, &b, 4); return x; }
FN int lowest(Bits x) { return __builtin_ctz(x); }
FN int rounded(float x) { return int(__builtin_lrintf(x)); }
FN int take_ticket(int* counter, int by) { int was = *counter; *counter += by; return was; }
FN void raise(int* to, int value) { if (value > *to) *to = value; }
#endif

// Threads of a card work in warps of 32 that share one instruction. Once their ways part they often
// stay apart, at a fraction of the speed, unless they are told to meet: loops over a grain's contacts
// therefore run to the longest of the warp, and every thread of a warp must reach what follows.
#if defined(__CUDACC__)
constexpr int WARP = 32;
FN int longest(int count) { return __reduce_max_sync(0xffffffffu, count); }
FN void meet() { __syncwarp(); }
#else
constexpr int WARP = 1;
FN int longest(int count) { return count; }
FN void meet() {}
#endif

// The threads that carry out one spoon. Every thread must reach every barrier.
struct Block {
    int thread, threads;
    // Whether any thread of the warp, of which this one is at `i`, is below `end`.
    FN bool goes_on(int i, int end) const { return i - (thread & (WARP - 1)) < end; }
#if defined(__CUDACC__)
    FN void barrier() const { __syncthreads(); }
    // A barrier, and whether the condition holds for any thread.
    FN bool any(bool condition) const { return __syncthreads_or(condition) != 0; }
    // Adds every thread's value to a counter.
    FN void add_up(int* counter, int value) const {
        int sum = __reduce_add_sync(0xffffffffu, value);
        if ((thread & 31) == 0) atomicAdd(counter, sum);
    }
    // Raises a counter to the largest of the threads' values.
    FN void raise_to(int* counter, int value) const {
        int top = __reduce_max_sync(0xffffffffu, value);
        if ((thread & 31) == 0) atomicMax(counter, top);
    }
    // Sum of the values of all earlier threads; `room` has a place for each warp.
    FN int before(int value, int* room) const {
        int lane = thread & 31, warp = thread >> 5, sum = value;
        for (int by = 1; by < 32; by <<= 1) {
            int other = __shfl_up_sync(0xffffffffu, sum, by);
            if (lane >= by) sum += other;
        }
        if (lane == 31) room[warp] = sum;
        barrier();
        int earlier = 0;
        for (int w = 0; w < warp; w++) earlier += room[w];
        return earlier + sum - value;
    }
#else
    FN void barrier() const {}
    FN bool any(bool condition) const { return condition; }
    FN void add_up(int* counter, int value) const { *counter += value; }
    FN void raise_to(int* counter, int value) const { raise(counter, value); }
    FN int before(int, int*) const { return 0; }
#endif
};
