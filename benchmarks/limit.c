/* The pairs of pixel and Gaussian of gsc_jax.splat.composite in C, as the limit of the machine.
 *
 * Tiles of 8 x 8 pixels walk their depth-sorted lists; the 64 pixels of a tile are the vector. exp is
 * a polynomial (relative error 2e-7 where alpha >= 1/255), so that the loop calls no function.
 * Counts the evaluated and the needed pairs.
 */
#include <math.h>
#include <string.h>

enum { SIDE = 8, PIXELS = SIDE * SIDE };

typedef struct {
    long evaluated; /* pairs until every pixel of the tile has stopped */
    long needed;    /* pairs with alpha >= 1/255 at a pixel that has not stopped */
} Counts;

static inline float exp_of(float x) {
    union { float f; int i; } power;
    float t = fmaxf(x * 1.44269504f, -126.0f), whole = floorf(t + 0.5f), r = (t - whole) * 0.69314718f;
    power.i = ((int)whole + 127) << 23;
    return power.f * (1.0f + r * (1.0f + r * (0.5f + r * (1.66666667e-1f + r * (4.16666667e-2f
                      + r * (8.3333333e-3f + r * 1.3888889e-3f))))));
}

static inline __attribute__((always_inline)) Counts blend_tile(const float *splats, const float *features, int channels, const int *ids,
                         int count, float x0, float y0, float *restrict out, int counting) {
    float x[PIXELS], y[PIXELS], light[PIXELS], weight[PIXELS];
    Counts counts = {0, 0};
    for (int p = 0; p < PIXELS; p++) {
        x[p] = x0 + (float)(p % SIDE) + 0.5f;
        y[p] = y0 + (float)(p / SIDE) + 0.5f;
        light[p] = 1.0f;
    }
    memset(out, 0, sizeof(float) * PIXELS * channels);
    for (int k = 0; k < count; k++) {
        const float *s = splats + 6 * (long)ids[k];
        float alive = 0.0f;
        for (int p = 0; p < PIXELS; p++) {
            float dx = x[p] - s[0], dy = y[p] - s[1];
            float u = s[2] * dx + s[3] * dy, v = s[4] * dy;
            float alpha = fminf(0.99f, exp_of(s[5] - u * u - v * v));
            alpha = alpha >= 1.0f / 255.0f ? alpha : 0.0f;
            float behind = light[p] * (1.0f - alpha);
            weight[p] = behind >= 1e-4f ? light[p] * alpha : 0.0f;
            light[p] = behind;
            alive = fmaxf(alive, behind);
        }
        const float *f = features + (long)channels * ids[k];
        for (int d = 0; d < channels; d++)
            for (int p = 0; p < PIXELS; p++) out[d * PIXELS + p] += weight[p] * f[d];
        if (counting) {
            counts.evaluated += PIXELS;
            for (int p = 0; p < PIXELS; p++) counts.needed += weight[p] > 0.0f;
        }
        if (alive < 1e-4f) break;
    }
    return counts;
}

/* Tiles one after the other, or shared between threads when built with OpenMP. */
Counts blend(const float *splats, const float *features, int channels, const int *ids,
             const int *tiles, const int *starts, const int *lengths, int listed, int columns,
             float *out, int counting, int threads) {
    long evaluated = 0, needed = 0;
#pragma omp parallel for schedule(dynamic, 16) reduction(+ : evaluated, needed) num_threads(threads)
    for (int t = 0; t < listed; t++) {
        float x0 = (float)(SIDE * (tiles[t] % columns)), y0 = (float)(SIDE * (tiles[t] / columns));
        float *tile = out + (long)tiles[t] * channels * PIXELS;
        /* A known number of channels lets the compiler unroll what it does to each pixel. */
        Counts counts =
            channels == 4 && !counting
                ? blend_tile(splats, features, 4, ids + starts[t], lengths[t], x0, y0, tile, 0)
                : blend_tile(splats, features, channels, ids + starts[t], lengths[t], x0, y0, tile,
                             counting);
        evaluated += counts.evaluated;
        needed += counts.needed;
    }
    Counts all = {evaluated, needed};
    return all;
}
