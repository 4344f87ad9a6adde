// Exponential, tanh and their relatives: operation by operation those of
// `crates/flip-learn/src/train/fused/curves.rs`, so their bits are equal. NaN stays NaN.
#pragma once

#include "platform.cuh"

#if defined(__CUDACC__)
FN float fused(float a, float b, float plus) { return __fmaf_rn(a, b, plus); }
FN float nearest(float x) { return rintf(x); }
#else
FN float fused(float a, float b, float plus) { return std::fma(a, b, plus); }
FN float nearest(float x) { return std::nearbyint(x); }
#endif
// The second where either is NaN.
FN float top(float a, float b) { return a > b ? a : b; }
FN float bottom(float a, float b) { return a < b ? a : b; }

FN float exponential(float x) {
    x = bottom(88.0f, top(-87.0f, x));
    float n = nearest(x * 1.44269504088896341f);
    float r = fused(n, -0.693359375f, x);
    r = fused(n, 2.1219444e-4f, r);
    float p = 1.9875691e-4f;
    p = fused(p, r, 1.3982e-3f);
    p = fused(p, r, 8.333452e-3f);
    p = fused(p, r, 4.1665796e-2f);
    p = fused(p, r, 1.6666665e-1f);
    p = fused(p, r, 5e-1f);
    return fused(p, r * r, r + 1.0f) * float_of(Bits(int(n) + 127) << 23);
}

FN float tangent(float x) {
    float size = top(0.0f - x, x);
    float far = 1.0f - 2.0f / (exponential(size * 2.0f) + 1.0f);
    if (x < 0.0f) far = 0.0f - far;
    float z = x * x;
    float p = -5.7049887e-3f;
    p = fused(p, z, 2.0639088e-2f);
    p = fused(p, z, -5.3739716e-2f);
    p = fused(p, z, 1.3331442e-1f);
    p = fused(p, z, -3.3333282e-1f);
    return 0.625f < size ? far : fused(p * z, x, x);
}

FN float softplus(float x) {
    float size = top(0.0f - x, x);
    float t = exponential(0.0f - size);
    float s = t / (t + 2.0f);
    float z = s * s;
    float p = 1.0f / 15.0f;
    p = fused(p, z, 1.0f / 13.0f);
    p = fused(p, z, 1.0f / 11.0f);
    p = fused(p, z, 1.0f / 9.0f);
    p = fused(p, z, 1.0f / 7.0f);
    p = fused(p, z, 1.0f / 5.0f);
    p = fused(p, z, 1.0f / 3.0f);
    p = fused(p, z, 1.0f);
    return fused(p * s, 2.0f, top(0.0f, x));
}
