/* SPDX-License-Identifier: Apache-2.0 */
/* Constrained conjugate gradients of an elastic layer, with convolutions by FFT: simulation/contact/layer.py. */
#include "kernels.h"

#define PI 3.14159265358979323846
#define MOST_STAGES 32

/* A complex FFT of length m over many lines at once, which are contiguous: Stockham's, quick for radix 2, 3, 4 and 5. */
typedef struct {
    int64_t m, stages, radix[MOST_STAGES];
    double *cosine, *sine; /* of 2 pi k / m */
} Plan;

/* Real and imaginary parts of m values of each line. */
typedef struct {
    double *re, *im;
} Complex;

static void plan(Plan *plan, int64_t m, double *table) {
    int64_t rest = m;
    plan->m = m;
    plan->stages = 0;
    for (int64_t r = 4; rest > 1; r = r == 4 ? 2 : r == 2 ? 3 : r + 2) {
        for (; rest % r == 0; rest /= r) {
            plan->radix[plan->stages++] = r;
        }
    }
    plan->cosine = table;
    plan->sine = table + m;
    for (int64_t k = 0; k < m; k++) {
        plan->cosine[k] = cos(2.0 * PI * (double)k / (double)m);
        plan->sine[k] = sin(2.0 * PI * (double)k / (double)m);
    }
}

/* One stage: r values of a line, apart by one part of the input, to r neighbours of the output, turned by their twiddles. */
VECTORISED static void stage2(const double *restrict xr, const double *restrict xi, double *restrict yr, double *restrict yi, int64_t part, int64_t run,
                              const double *c, const double *s) {
    for (int64_t i = 0; i < run; i++) {
        const double dr = xr[i] - xr[part + i], di = xi[i] - xi[part + i];
        yr[i] = xr[i] + xr[part + i];
        yi[i] = xi[i] + xi[part + i];
        yr[run + i] = dr * c[1] + di * s[1];
        yi[run + i] = di * c[1] - dr * s[1];
    }
}

VECTORISED static void stage4(const double *restrict xr, const double *restrict xi, double *restrict yr, double *restrict yi, int64_t part, int64_t run,
                              const double *c, const double *s) {
    for (int64_t i = 0; i < run; i++) {
        const double ar = xr[i] + xr[2 * part + i], ai = xi[i] + xi[2 * part + i];
        const double br = xr[i] - xr[2 * part + i], bi = xi[i] - xi[2 * part + i];
        const double cr = xr[part + i] + xr[3 * part + i], ci = xi[part + i] + xi[3 * part + i];
        const double dr = xi[part + i] - xi[3 * part + i], di = xr[3 * part + i] - xr[part + i]; /* -i times */
        const double er = br + dr, ei = bi + di, fr = ar - cr, fi = ai - ci, gr = br - dr, gi = bi - di;
        yr[i] = ar + cr;
        yi[i] = ai + ci;
        yr[run + i] = er * c[1] + ei * s[1];
        yi[run + i] = ei * c[1] - er * s[1];
        yr[2 * run + i] = fr * c[2] + fi * s[2];
        yi[2 * run + i] = fi * c[2] - fr * s[2];
        yr[3 * run + i] = gr * c[3] + gi * s[3];
        yi[3 * run + i] = gi * c[3] - gr * s[3];
    }
}

VECTORISED static void stage3(const double *restrict xr, const double *restrict xi, double *restrict yr, double *restrict yi, int64_t part, int64_t run,
                              const double *c, const double *s) {
    const double root = 0.86602540378443864676;
    for (int64_t i = 0; i < run; i++) {
        const double sr = xr[part + i] + xr[2 * part + i], si = xi[part + i] + xi[2 * part + i];
        const double dr = root * (xi[part + i] - xi[2 * part + i]), di = root * (xr[2 * part + i] - xr[part + i]);
        const double hr = xr[i] - 0.5 * sr, hi = xi[i] - 0.5 * si;
        const double ar = hr + dr, ai = hi + di, br = hr - dr, bi = hi - di;
        yr[i] = xr[i] + sr;
        yi[i] = xi[i] + si;
        yr[run + i] = ar * c[1] + ai * s[1];
        yi[run + i] = ai * c[1] - ar * s[1];
        yr[2 * run + i] = br * c[2] + bi * s[2];
        yi[2 * run + i] = bi * c[2] - br * s[2];
    }
}

VECTORISED static void stage5(const double *restrict xr, const double *restrict xi, double *restrict yr, double *restrict yi, int64_t part, int64_t run,
                              const double *c, const double *s) {
    const double c1 = 0.30901699437494742410, c2 = -0.80901699437494742410;
    const double s1 = 0.95105651629515357212, s2 = 0.58778525229247312917;
    for (int64_t i = 0; i < run; i++) {
        const double pr = xr[part + i] + xr[4 * part + i], pi = xi[part + i] + xi[4 * part + i];
        const double qr = xr[2 * part + i] + xr[3 * part + i], qi = xi[2 * part + i] + xi[3 * part + i];
        const double ur = xr[part + i] - xr[4 * part + i], ui = xi[part + i] - xi[4 * part + i];
        const double vr = xr[2 * part + i] - xr[3 * part + i], vi = xi[2 * part + i] - xi[3 * part + i];
        const double ar = xr[i] + c1 * pr + c2 * qr, ai = xi[i] + c1 * pi + c2 * qi;
        const double br = xr[i] + c2 * pr + c1 * qr, bi = xi[i] + c2 * pi + c1 * qi;
        const double er = s1 * ui + s2 * vi, ei = -s1 * ur - s2 * vr;
        const double fr = s2 * ui - s1 * vi, fi = -s2 * ur + s1 * vr;
        const double zr[5] = {0, ar + er, br + fr, br - fr, ar - er}, zi[5] = {0, ai + ei, bi + fi, bi - fi, ai - ei};
        yr[i] = xr[i] + pr + qr;
        yi[i] = xi[i] + pi + qi;
        for (int j = 1; j < 5; j++) {
            yr[j * run + i] = zr[j] * c[j] + zi[j] * s[j];
            yi[j * run + i] = zi[j] * c[j] - zr[j] * s[j];
        }
    }
}

/* As these, for any r: the sums of its definition. `turn` are steps in the table of the plan. */
static void stage_any(const Plan *plan, int64_t r, const double *xr, const double *xi, double *yr, double *yi, int64_t part,
                      int64_t run, int64_t turn) {
    for (int64_t j = 0; j < r; j++) {
        const double c = plan->cosine[j * turn], s = plan->sine[j * turn];
        for (int64_t i = 0; i < run; i++) {
            double re = 0.0, im = 0.0;
            for (int64_t k = 0; k < r; k++) {
                const int64_t at = j * k % r * (plan->m / r);
                re += xr[k * part + i] * plan->cosine[at] + xi[k * part + i] * plan->sine[at];
                im += xi[k * part + i] * plan->cosine[at] - xr[k * part + i] * plan->sine[at];
            }
            yr[j * run + i] = re * c + im * s;
            yi[j * run + i] = im * c - re * s;
        }
    }
}

/* Of x; y is as large. Returns which of both holds the result. */
static Complex transform(const Plan *plan, int64_t lines, Complex x, Complex y) {
    int64_t length = plan->m, stride = 1;
    for (int64_t stage = 0; stage < plan->stages; stage++) {
        const int64_t r = plan->radix[stage], parts = length / r, run = stride * lines;
        for (int64_t p = 0; p < parts; p++) {
            double c[5], s[5];
            for (int64_t j = 0; j < r && j < 5; j++) {
                c[j] = plan->cosine[p * j * stride];
                s[j] = plan->sine[p * j * stride];
            }
            const double *xr = x.re + p * run, *xi = x.im + p * run;
            double *yr = y.re + r * p * run, *yi = y.im + r * p * run;
            switch (r) {
            case 2: stage2(xr, xi, yr, yi, parts * run, run, c, s); break;
            case 3: stage3(xr, xi, yr, yi, parts * run, run, c, s); break;
            case 4: stage4(xr, xi, yr, yi, parts * run, run, c, s); break;
            case 5: stage5(xr, xi, yr, yi, parts * run, run, c, s); break;
            default: stage_any(plan, r, xr, xi, yr, yi, parts * run, run, p * stride);
            }
        }
        const Complex old = x;
        x = y;
        y = old;
        length = parts;
        stride *= r;
    }
    return x;
}

static Complex inverse(const Plan *plan, int64_t lines, Complex x, Complex y) {
    const Complex swapped = transform(plan, lines, (Complex){x.im, x.re}, (Complex){y.im, y.re});
    return (Complex){swapped.im, swapped.re};
}

/* Room for one convolution: two arrays of m (n + 1) complex values. */
typedef struct {
    Plan plan;
    Complex x, y;
} Convolution;

/* room: 4 m (n + 1) + 2 m. */
static void prepare(Convolution *convolution, int64_t n, double *room) {
    const int64_t m = 2 * n, size = m * (n + 1);
    convolution->x = (Complex){room, room + size};
    convolution->y = (Complex){room + 2 * size, room + 3 * size};
    plan(&convolution->plan, m, room + 4 * size);
}

/* result (n, n): the convolution of p (n, n) with the coefficients whose spectrum (2n, n + 1, 2) is given. */
static void convolve(Convolution *convolution, int64_t n, const double *p, const double *spectrum, double *result) {
    const int64_t m = 2 * n, pairs = (n + 1) / 2, waves = n + 1;
    Complex x = convolution->x, y = convolution->y;
    /* Two real rows are the parts of one complex line. */
    memset(x.re + n * pairs, 0, (size_t)(n * pairs) * sizeof(double));
    memset(x.im + n * pairs, 0, (size_t)(n * pairs) * sizeof(double));
    for (int64_t i = 0; i < pairs; i++) {
        for (int64_t c = 0; c < n; c++) {
            x.re[c * pairs + i] = p[2 * i * n + c];
            x.im[c * pairs + i] = 2 * i + 1 < n ? p[(2 * i + 1) * n + c] : 0.0;
        }
    }
    Complex z = transform(&convolution->plan, pairs, x, y), other = z.re == x.re ? y : x;
    for (int64_t i = 0; i < pairs; i++) {
        for (int64_t k = 0; k < waves; k++) {
            const int64_t here = k * pairs + i, there = (m - k) % m * pairs + i;
            const double ar = z.re[here], ai = z.im[here], br = z.re[there], bi = -z.im[there];
            other.re[2 * i * waves + k] = 0.5 * (ar + br);
            other.im[2 * i * waves + k] = 0.5 * (ai + bi);
            if (2 * i + 1 < n) {
                other.re[(2 * i + 1) * waves + k] = 0.5 * (ai - bi);
                other.im[(2 * i + 1) * waves + k] = -0.5 * (ar - br);
            }
        }
    }
    memset(other.re + n * waves, 0, (size_t)(n * waves) * sizeof(double));
    memset(other.im + n * waves, 0, (size_t)(n * waves) * sizeof(double));
    Complex w = transform(&convolution->plan, waves, other, z), rest = w.re == other.re ? z : other;
    const double share = 1.0 / ((double)m * (double)m);
    for (int64_t k = 0; k < m * waves; k++) {
        const double ar = w.re[k], ai = w.im[k], br = share * spectrum[2 * k], bi = share * spectrum[2 * k + 1];
        w.re[k] = ar * br - ai * bi;
        w.im[k] = ar * bi + ai * br;
    }
    Complex a = inverse(&convolution->plan, waves, w, rest), free_one = a.re == w.re ? rest : w;
    for (int64_t i = 0; i < pairs; i++) {
        const int odd = 2 * i + 1 < n;
        for (int64_t k = 0; k < m; k++) {
            const int64_t from = 2 * i * waves + (k < waves ? k : m - k);
            const double sign = k < waves ? 1.0 : -1.0;
            const double ur = a.re[from], ui = sign * a.im[from];
            const double vr = odd ? a.re[from + waves] : 0.0, vi = odd ? sign * a.im[from + waves] : 0.0;
            free_one.re[k * pairs + i] = ur - vi;
            free_one.im[k * pairs + i] = ui + vr;
        }
    }
    const Complex q = inverse(&convolution->plan, pairs, free_one, a);
    for (int64_t i = 0; i < pairs; i++) {
        for (int64_t c = 0; c < n; c++) {
            result[2 * i * n + c] = q.re[c * pairs + i];
            if (2 * i + 1 < n) {
                result[(2 * i + 1) * n + c] = q.im[c * pairs + i];
            }
        }
    }
}

static double mean_depth(const double *displacement, const double *gap, const double *pressure, int64_t size) {
    double sum = 0.0;
    int64_t count = 0;
    for (int64_t i = 0; i < size; i++) {
        if (pressure[i] > 0.0) {
            sum += displacement[i] + gap[i];
            count++;
        }
    }
    return sum / (double)count;
}

/* Steps until the tolerance is met or the iterations are spent. pressure (n, n) is the start and becomes the result.
 * end (4): depth, iterations, residual, and 1 where it
 * ran: 0 without memory. Where neither clipping nor new cells disturb a step, K p follows from K t of the step instead of
 * a second convolution. */
void layer_descent(const double *gap, const double *spectrum, int64_t n, const Descent *how, double *pressure,
                   double *end) {
    const int64_t size = n * n, by_force = how->by_force;
    const double given = how->given, safe_length = how->safe_length;
    Convolution convolution;
    double *room = malloc((size_t)(6 * size + 8 * n * (n + 1) + 4 * n) * sizeof(double));
    end[3] = room != NULL;
    if (!room) {
        return;
    }
    prepare(&convolution, n, room + 6 * size);
    double *displacement = room, *t = room + size, *q = room + 2 * size, *r = room + 3 * size, *g = room + 4 * size;
    double *old = room + 5 * size, last = INFINITY, residual = INFINITY;
    int64_t iterations = 0;
    memset(t, 0, (size_t)size * sizeof(double));
    convolve(&convolution, n, pressure, spectrum, displacement);
    while (iterations < how->most && residual >= how->tolerance) {
        const double depth = by_force ? mean_depth(displacement, gap, pressure, size) : given;
        double squares = 0.0, bend = 0.0, along = 0.0, t_sum = 0.0, q_wet = 0.0, total = 0.0, change = 0.0;
        int64_t wet = 0;
        int grown = 0, clipped = 0;
        for (int64_t i = 0; i < size; i++) {
            r[i] = displacement[i] + gap[i] - depth;
            g[i] = pressure[i] > 0.0 ? r[i] : 0.0;
            squares += g[i] * g[i];
        }
        for (int64_t i = 0; i < size; i++) {
            t[i] = g[i] + (pressure[i] > 0.0 ? squares / last * t[i] : 0.0);
        }
        convolve(&convolution, n, t, spectrum, q);
        for (int64_t i = 0; i < size; i++) {
            bend += t[i] * q[i];
            along += g[i] * t[i];
            t_sum += t[i];
            q_wet += pressure[i] > 0.0 ? q[i] : 0.0;
            wet += pressure[i] > 0.0;
        }
        if (by_force) { /* the depth is free: only what departs from the mean counts */
            bend -= t_sum * q_wet / (double)(wet > 1 ? wet : 1);
        }
        const double length = bend > 0.0 ? along / bend : safe_length;
        const double join = length < safe_length ? length : safe_length;
        last = squares > 0.0 ? squares : INFINITY;
        for (int64_t i = 0; i < size; i++) {
            old[i] = pressure[i];
            double value = old[i] - length * t[i];
            const int negative = value < 0.0;
            if (r[i] < 0.0 && !(old[i] > 0.0)) { /* it overlaps and joins, by a step that cannot overshoot */
                value -= join * r[i];
                grown = 1;
            }
            clipped |= negative;
            pressure[i] = negative ? 0.0 : value;
            total += pressure[i];
        }
        if (grown) {
            last = INFINITY;
        }
        if (grown || clipped) {
            convolve(&convolution, n, pressure, spectrum, displacement);
        } else {
            for (int64_t i = 0; i < size; i++) {
                displacement[i] -= length * q[i];
            }
        }
        const double scale = by_force && total > 0.0 ? given / total : 1.0;
        for (int64_t i = 0; i < size; i++) {
            pressure[i] *= scale;
            displacement[i] *= scale;
            change += fabs(pressure[i] - old[i]);
        }
        iterations++;
        residual = change / (total > 2.2250738585072014e-308 ? total : 2.2250738585072014e-308);
    }
    end[0] = by_force ? mean_depth(displacement, gap, pressure, size) : given;
    end[1] = (double)iterations;
    end[2] = residual;
    free(room);
}
