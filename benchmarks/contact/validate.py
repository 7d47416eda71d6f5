# SPDX-License-Identifier: Apache-2.0
"""How right is each level of contact, and what does it cost?

Prints the error against closed forms and fine solves first, then CPU time per contact.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence

import numpy as np
from contacts import random_contacts

from foretouch.simulation.contact import (
    Command,
    ContactProblem,
    Layer,
    PadConfig,
    choose_level,
    solve_contact,
    solve_grip,
    solve_layer,
    solve_winkler,
)
from foretouch.simulation.contact.layer import _influence_spectrum
from foretouch.simulation.fingertip import ThumbConfig, draw_finger, read_contact

RADIUS_M = 0.01
FOAM = Layer(modulus_pa=1e5, poisson=0.3, thickness_m=0.03)
RUBBER = Layer(modulus_pa=1e6, poisson=0.3, thickness_m=0.01)
THREE_NEWTONS = Command(force_n=3.0)
REPEATS = 15
CONTACTS = 40


def paraboloid(n: int, side_m: float, layer: Layer) -> ContactProblem:
    step = side_m / n
    offset = (np.arange(n) - (n - 1) / 2.0) * step
    gap = np.add.outer(offset**2, offset**2) / (2.0 * RADIUS_M)
    return ContactProblem(gap - gap.min(), step, (layer,))


def hertz_force(layer: Layer, depth_m: float) -> float:
    return 4.0 / 3.0 * layer.plane_modulus_pa * math.sqrt(RADIUS_M) * depth_m**1.5


def dimitriadis_factor(layer: Layer, depth_m: float) -> float:
    """Dimitriadis et al. 2002, eq. 12, over Hertz."""
    nu, pi = layer.poisson, math.pi
    a = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    b = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    chi = math.sqrt(RADIUS_M * depth_m) / layer.thickness_m
    cubic, quartic = a**3 + 4 * pi**2 / 15 * b, a**3 + 3 * pi**2 / 5 * b
    powers = (1.0, -2 * a / pi, 4 * a**2 / pi**2, -8 / pi**3 * cubic, 16 * a / pi**4 * quartic)
    return sum(c * chi**k for k, c in enumerate(powers))


def closed_forms() -> list[tuple[str, float, float]]:
    """Name, worst error, bound."""
    rubber = Layer(modulus_pa=1e6, poisson=0.3)
    hertz = []
    for relative in (1e-4, 1e-3, 1e-2, 1e-1):
        depth = relative * RADIUS_M
        problem = paraboloid(64, 2.6 * math.sqrt(RADIUS_M * depth), rubber)
        hertz.append(solve_layer(problem, Command(depth_m=depth)).force_n / hertz_force(rubber, depth) - 1.0)
    step = 2.2 * 0.003 / 64
    offset = (np.arange(64) - 31.5) * step
    punch = np.where(np.hypot(*np.meshgrid(offset, offset)) <= 0.003, 0.0, np.inf)
    flat = solve_layer(ContactProblem(punch, step, (rubber,)), Command(depth_m=1e-4)).force_n
    thin = []
    for nu in (0.0, 0.3, 0.45, 0.5):
        for thickness in (0.02, 0.01, 0.005, 0.003):
            layer = Layer(modulus_pa=1e6, poisson=nu, thickness_m=thickness)
            problem = paraboloid(64, 2.6 * math.sqrt(RADIUS_M * 1e-4), layer)
            expected = hertz_force(layer, 1e-4) * dimitriadis_factor(layer, 1e-4)
            thin.append(solve_layer(problem, Command(depth_m=1e-4)).force_n / expected - 1.0)
    return [
        ("Hertz, depth/radius 1e-4 to 0.1", max(map(abs, hertz)), 0.01),
        ("flat punch (Sneddon)", abs(flat / (2.0 * 0.003 * rubber.plane_modulus_pa * 1e-4) - 1.0), 0.01),
        ("thin layer (Dimitriadis), √(Rd)/h 0.05 to 0.33, ν 0 to 0.5", max(map(abs, thin)), 0.05),
    ]


def balances() -> list[tuple[str, float, float]]:
    pad = PadConfig()
    contacts = list(random_contacts(40, 0, pad))
    sums = [
        abs(solve_contact(p, Command(force_n=f), level).pressure.sum() * p.cell_m2 / f - 1.0)
        for _, p, f in contacts
        for level in ("winkler", "layer")
    ]
    grips = []
    for a, b in zip(contacts[::2], contacts[1::2], strict=True):
        first, second = solve_grip([a[1], b[1]], [Command(depth_m=2e-4)] * 2, balanced=True)
        grips.append(abs(first.force_n - second.force_n) / max(first.force_n, second.force_n))
    return [("Σ p·A against the force", max(sums), 1e-3), ("force balance of two fingers", max(grips), 1e-3)]


def pattern_errors(
    name: str, other: Layer | None, force_scale: float, cases: Sequence[tuple[str, int]]
) -> list[tuple[str, str, float, float]]:
    """Object, level and grid; median and largest error of the electrode pattern against layer 128x128."""
    finger = draw_finger(ThumbConfig(), np.random.default_rng(0))
    base = PadConfig() if other is None else PadConfig().soft

    def patterns(level: str, cells: int) -> list[np.ndarray]:
        pad = base.replace(cells=cells)
        return [
            finger.electrode_rest
            - read_contact(pad, finger, window, solve_contact(problem, Command(force_n=force_scale * force), level))[1:]
            for window, problem, force in random_contacts(CONTACTS, 5, pad, other)
        ]

    fine = patterns("layer", 128)
    rows = []
    for level, cells in cases:
        errors = [
            float(np.linalg.norm(a - b) / np.linalg.norm(b)) for a, b in zip(patterns(level, cells), fine, strict=True)
        ]
        auto = (
            " (auto)"
            if cells == 24 and level == choose_level((base.layer,) if other is None else (base.layer, other))[0]
            else ""
        )
        rows.append((name, f"{level} {cells}x{cells}{auto}", statistics.median(errors), max(errors)))
    return rows


def cpu_ms(call: Callable[[], object], inner: int = 10) -> float:
    call()
    times = []
    for _ in range(REPEATS):
        begin = time.thread_time()
        for _ in range(inner):
            call()
        times.append((time.thread_time() - begin) / inner)
    return 1e3 * statistics.median(times)


def costs() -> list[tuple[str, float]]:
    """CPU time on one thread; the product of two 512x512 matrices stands beside as this machine's measure."""
    matrix = np.random.default_rng(0).random((512, 512))
    rows = [("512x512 matrix product (baseline)", cpu_ms(lambda: matrix @ matrix))]
    finger = draw_finger(ThumbConfig(), np.random.default_rng(0))
    for cells in (24, 32, 64):
        pad = PadConfig(cells=cells)
        window, problem, _ = next(random_contacts(1, 0, pad))
        _, soft, _ = next(random_contacts(1, 0, pad.soft, FOAM))
        solution = solve_winkler(problem, THREE_NEWTONS)
        rows += [
            (f"Winkler {cells}x{cells}", cpu_ms(lambda p=problem: solve_winkler(p, THREE_NEWTONS))),
            (f"elastic layer {cells}x{cells}, rigid object", cpu_ms(lambda p=problem: solve_layer(p, THREE_NEWTONS))),
            (f"elastic layer {cells}x{cells}, foam", cpu_ms(lambda p=soft: solve_layer(p, Command(force_n=1.0)))),
            (
                f"24 electrodes and PDC from {cells}x{cells}",
                cpu_ms(lambda p=pad, w=window, s=solution: read_contact(p, finger, w, s)),
            ),
        ]
    smooth = paraboloid(24, 0.012, PadConfig().layer)
    rows.append(("Hertz 24x24", cpu_ms(lambda: solve_contact(smooth, Command(force_n=1.0), "hertz"))))
    rows.append(("influence spectrum of a new layer, 24x24", cpu_ms(_fresh_spectrum)))
    return rows


def _fresh_spectrum() -> None:
    _influence_spectrum.cache_clear()
    _influence_spectrum(FOAM, 24, 0.02 / 24)


def main() -> None:
    print("| check | worst | must |\n|---|---|---|")
    for name, error, bound in closed_forms() + balances():
        print(f"| {name} | {error:.2g} | {bound:g} |{'' if error <= bound else ' **missed**'}")
    print("\n| object | level | electrode pattern, median | largest |\n|---|---|---|---|")
    cases: list[tuple[str, int]] = [("winkler", 24), ("layer", 24), ("layer", 32), ("layer", 64)]
    for name, other, scale in (
        ("rigid", None, 1.0),
        ("rubber 1 MPa, 10 mm", RUBBER, 1.0),
        ("foam 100 kPa, 30 mm", FOAM, 1.0),
    ):
        for row in pattern_errors(name, other, scale, cases):
            print(f"| {row[0]} | {row[1]} | {row[2]:.2%} | {row[3]:.2%} |")
    print("\n| cost | CPU ms |\n|---|---|")
    for name, ms in costs():
        print(f"| {name} | {ms:.3f} |")


if __name__ == "__main__":
    main()
