"""Generated C of an IMM beside a loop written by hand: the flights of section 5 of Hwang et al. (2006).

    python -m benchmarks.filter_code

100 flights of 150 rows.  The hand-written step knows this model's sizes and uses `log` and `exp` of the C library; it
makes the same estimates, which is checked.  Both are compiled by gcc and take turns in one program; a time is the best
of 20 rounds of processor time.
"""

import subprocess
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.filters import flown, system_of
from deshybrid.emit.filters import FilterModel, emit_filter_c
from deshybrid.emit.provenance import Provenance

NAMES = (("x1", "v1", "a1", "x2", "v2", "a2"), (), ("y1", "y2"))
HAND = r"""
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include "man.h"

enum { M = 2, N = 6, R = 2 };
TABLES
typedef struct { double x[M][N], P[M][N][N], mu[M]; } hand_t;

static void hand_init(hand_t *s)
{
    for (int j = 0; j < M; ++j) {
        memcpy(s->x[j], X0, sizeof X0);
        memcpy(s->P[j], P0, sizeof P0);
        s->mu[j] = MU0[j];
    }
}

static void blend(const hand_t *s, const double *w, double *x, double (*P)[N])
{
    for (int a = 0; a < N; ++a) {
        x[a] = 0.0;
        for (int i = 0; i < M; ++i) x[a] += w[i] * s->x[i][a];
    }
    memset(P, 0, sizeof(double) * N * N);
    for (int i = 0; i < M; ++i) {
        double d[N];
        for (int a = 0; a < N; ++a) d[a] = s->x[i][a] - x[a];
        for (int a = 0; a < N; ++a)
            for (int b = 0; b <= a; ++b) P[a][b] += w[i] * (s->P[i][a][b] + d[a] * d[b]);
    }
    for (int a = 0; a < N; ++a)
        for (int b = 0; b < a; ++b) P[b][a] = P[a][b];
}

static void hand_step(hand_t *s, const double *z, double *x_hat, double (*P_hat)[N])
{
    double predicted[M], x0[M][N], P1[M][N][N], like[M], best = 1e300, total = 0.0;
    for (int j = 0; j < M; ++j) {
        double w[M];
        predicted[j] = 0.0;
        for (int i = 0; i < M; ++i) predicted[j] += PI[j][i] * s->mu[i];
        for (int i = 0; i < M; ++i) w[i] = PI[j][i] * s->mu[i] / predicted[j];
        blend(s, w, x0[j], P1[j]);
    }
    for (int j = 0; j < M; ++j) {
        double FP[N][N], HP[R][N], S[R][R], e[R], *x = s->x[j];
        for (int a = 0; a < N; ++a) {
            x[a] = 0.0;
            for (int k = 0; k < N; ++k) x[a] += F[j][a][k] * x0[j][k];
            for (int b = 0; b < N; ++b) {
                FP[a][b] = 0.0;
                for (int k = 0; k < N; ++k) FP[a][b] += F[j][a][k] * P1[j][k][b];
            }
        }
        for (int a = 0; a < N; ++a)
            for (int b = 0; b <= a; ++b) {
                double t = Q[j][a][b];
                for (int k = 0; k < N; ++k) t += FP[a][k] * F[j][b][k];
                s->P[j][a][b] = s->P[j][b][a] = t;
            }
        for (int i = 0; i < R; ++i) {
            e[i] = z[i];
            for (int k = 0; k < N; ++k) e[i] -= H[j][i][k] * x[k];
            for (int b = 0; b < N; ++b) {
                HP[i][b] = 0.0;
                for (int k = 0; k < N; ++k) HP[i][b] += H[j][i][k] * s->P[j][k][b];
            }
            for (int b = 0; b <= i; ++b) {
                S[i][b] = RR[j][i][b];
                for (int k = 0; k < N; ++k) S[i][b] += HP[i][k] * H[j][b][k];
            }
        }
        {
            const double l = S[1][0] / S[0][0], d1 = S[1][1] - l * S[1][0], d0 = S[0][0];
            double e1 = e[1] - l * e[0], W[N];
            for (int a = 0; a < N; ++a) W[a] = HP[1][a] - l * HP[0][a];
            for (int a = 0; a < N; ++a) {
                x[a] += HP[0][a] * e[0] / d0 + W[a] * e1 / d1;
                for (int b = 0; b <= a; ++b) {
                    s->P[j][a][b] -= HP[0][a] / d0 * HP[0][b] + W[a] / d1 * W[b];
                    s->P[j][b][a] = s->P[j][a][b];
                }
            }
            like[j] = e[0] * e[0] / d0 + e1 * e1 / d1 + log(d0 * d1);
            if (like[j] < best) best = like[j];
        }
    }
    for (int j = 0; j < M; ++j) total += s->mu[j] = predicted[j] * exp(0.5 * (best - like[j]));
    for (int j = 0; j < M; ++j) s->mu[j] /= total;
    blend(s, s->mu, x_hat, P_hat);
}

#define ROWS 150
#define FLIGHTS 100
static double z[FLIGHTS][ROWS][R];

static double now(void) { return (double)clock() / CLOCKS_PER_SEC; }

int main(void)
{
    double best[2] = {1e9, 1e9}, worst = 0.0, x[N], P[N][N], sink = 0.0;
    static man_output_t out;
    static double last[FLIGHTS][N];
    FILE *in = fopen("z.bin", "rb");
    if (!in || fread(z, sizeof z, 1, in) != 1) return 2;
    for (int round = 0; round < 20; ++round) {
        double t = now();
        for (int k = 0; k < FLIGHTS; ++k) {
            hand_t s;
            hand_init(&s);
            for (int r = 0; r < ROWS; ++r) hand_step(&s, z[k][r], x, P);
            memcpy(last[k], x, sizeof x);
            sink += P[0][0];
        }
        t = now() - t;
        if (t < best[0]) best[0] = t;
        t = now();
        for (int k = 0; k < FLIGHTS; ++k) {
            man_state_t s;
            man_input_t in_row;
            man_init(&s);
            for (int r = 0; r < ROWS; ++r) {
                memcpy(in_row.y, z[k][r], sizeof in_row.y);
                man_step(&s, &in_row, &out);
            }
            for (int a = 0; a < N; ++a)
                if (fabs(out.x_hat[a] - last[k][a]) > worst) worst = fabs(out.x_hat[a] - last[k][a]);
        }
        t = now() - t;
        if (t < best[1]) best[1] = t;
    }
    printf("%.3f %.3f %g %g\n", 1e6 * best[0] / FLIGHTS / ROWS, 1e6 * best[1] / FLIGHTS / ROWS, worst, sink * 0.0);
    return 0;
}
"""


def braces(array) -> str:
    return repr(array.tolist()).replace("[", "{").replace("]", "}")


def main() -> None:
    system, flights = system_of("maneuver"), flown(30.0, seed=5)
    bank = system.bank
    arrays = {"F": bank.F, "Q": bank.Q, "H": bank.H, "RR": bank.R, "PI": system.chain.probability_to_from}
    arrays |= {"X0": system.x, "P0": system.P, "MU0": system.mu}
    tables = "\n".join(
        f"static const double {name}{''.join(f'[{size}]' for size in array.shape)} = {braces(array)};"
        for name, array in arrays.items()
    )
    origin = Provenance("maneuver", "maneuver.yaml", "none", "benchmark")
    code = emit_filter_c(FilterModel(system, "imm", *NAMES), prefix="man", real="double", provenance=origin)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in code.items():
            (folder / file).write_text(text)
        (folder / "hand.c").write_text(HAND.replace("TABLES", tables))
        np.ascontiguousarray(flights.z).tofile(folder / "z.bin")
        print("| gcc | by hand, µs a row | generated, µs a row | ratio |", "|---|---|---|---|", sep="\n")
        for flags in ("-O2", "-O3"):
            command = ["gcc", "-std=gnu99", flags, "-ffp-contract=off", "-o", "both", "man.c", "hand.c", "-lm"]
            subprocess.run(command, cwd=folder, check=True)
            done = subprocess.run(["./both"], cwd=folder, check=True, capture_output=True, text=True).stdout.split()
            hand, made, worst = (float(word) for word in done[:3])
            assert worst < 1e-6, worst
            print(f"| {flags} | {hand:.3f} | {made:.3f} | {made / hand:.2f} |")


if __name__ == "__main__":
    main()
