"""Makes data/forced_motion.json: a held wrench in both frames on a triaxial body, to 30 digits.

    python test/verification/make_reference.py

A Taylor series in mpmath at 60 digits: quaternion, angular velocity about the body axes with the full inertia matrix,
motion of the centre of mass, and the integrals of force, torque and power as further unknowns. It shares nothing with
the package, neither code nor equations: the package works in principal axes and with angular momentum.
"""

from __future__ import annotations

import json
from pathlib import Path

from mpmath import matrix, mp, mpf, nstr

ORDER = 45
STEP = "0.0625"
TIMES = (1, 2, 5, 10)
DIGITS = 30
TARGET = Path(__file__).parent / "data" / "forced_motion.json"

CASE = {
    "mass": 3.7,
    "center_of_mass": [0.11, -0.07, 0.23],
    "inertia": [[2.1, 0.13, -0.27], [0.13, 1.7, 0.31], [-0.27, 0.31, 2.9]],
    "position_world": [1.5, -2.0, 0.25],
    "orientation_xyzw": [0.5, -0.1, 0.7, 0.5],
    "linear_velocity_world": [0.3, -0.1, 0.2],
    "angular_velocity_body": [0.7, -1.1, 0.9],
    "force_body": [0.9, -0.4, 0.6],
    "torque_body": [0.3, -0.2, 0.25],
    "force_world": [-0.5, 0.8, 0.3],
    "torque_world": [0.2, 0.35, -0.3],
}


def numbers(values):
    """Return the IEEE doubles nearest to the decimals shown, exactly."""
    return [mpf(float(v)) for v in values]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def rotation_entries(xx, yy, zz, ww, xy, xz, yz, xw, yw, zw):
    """Return R(q) from the products of the components of q; homogeneous, so that it holds for coefficients too."""
    return [
        [xx - yy - zz + ww, 2 * (xy - zw), 2 * (xz + yw)],
        [2 * (xy + zw), yy - xx - zz + ww, 2 * (yz - xw)],
        [2 * (xz - yw), 2 * (yz + xw), zz - xx - yy + ww],
    ]


def rotation(q):
    x, y, z, w = q
    return rotation_entries(x * x, y * y, z * z, w * w, x * y, x * z, y * z, x * w, y * w, z * w)


def times(rows, v):
    return [sum(row[i] * v[i] for i in range(3)) for row in rows]


def transposed(rows):
    return [[rows[j][i] for j in range(3)] for i in range(3)]


def value(series, h):
    """Return the polynomial with these coefficients, lowest first, at h (Horner)."""
    total = mpf(0)
    for coefficient in reversed(series):
        total = total * h + coefficient
    return total


class Motion:
    """The unknowns: q (4), w (3, body), x and v of the centre of mass (3 + 3), impulses (3 + 3) and work."""

    def __init__(self, case):
        inertia = matrix([numbers(row) for row in case["inertia"]])
        self.inertia = [[inertia[i, j] for j in range(3)] for i in range(3)]
        inverse = inertia**-1
        self.inverse = [[inverse[i, j] for j in range(3)] for i in range(3)]
        self.mass = mpf(case["mass"])
        self.force_body, self.torque_body = numbers(case["force_body"]), numbers(case["torque_body"])
        self.force_world, self.torque_world = numbers(case["force_world"]), numbers(case["torque_world"])
        self.arm = numbers(case["center_of_mass"])
        q = numbers(case["orientation_xyzw"])
        length = mp.sqrt(sum(c * c for c in q))
        q = [c / length for c in q]
        w = numbers(case["angular_velocity_body"])
        turn = rotation(q)
        x = [a + b for a, b in zip(numbers(case["position_world"]), times(turn, self.arm), strict=True)]
        spin = times(turn, cross(w, self.arm))
        v = [a + b for a, b in zip(numbers(case["linear_velocity_world"]), spin, strict=True)]
        self.start = [*q, *w, *x, *v, *([mpf(0)] * 7)]

    def coefficients(self, y, order):
        """Return the Taylor coefficients of all unknowns at the point y, by recurrence."""
        c = [[component] for component in y]

        def product(a, b, n):
            return mp.fdot(a[: n + 1], b[n::-1])

        momentum, torque, force = ([[], [], []] for _ in range(3))
        torque_body = [[], [], []]
        for n in range(order):
            x, y_, z, w = c[0], c[1], c[2], c[3]
            pairs = ((x, x), (y_, y_), (z, z), (w, w), (x, y_), (x, z), (y_, z), (x, w), (y_, w), (z, w))
            turn = rotation_entries(*(product(a, b, n) for a, b in pairs))
            omega, velocity = c[4:7], c[10:13]
            now = [o[n] for o in omega]
            constant = 1 if n == 0 else 0
            f = times(turn, self.force_body)
            t = times(turn, self.torque_body)
            tb = times(transposed(turn), self.torque_world)
            m = times(self.inertia, now)
            for i in range(3):
                force[i].append(f[i] + constant * self.force_world[i])
                torque[i].append(t[i] + constant * self.torque_world[i])
                torque_body[i].append(tb[i] + constant * self.torque_body[i])
                momentum[i].append(m[i])
            gyro = [
                product(omega[(i + 1) % 3], momentum[(i + 2) % 3], n)
                - product(omega[(i + 2) % 3], momentum[(i + 1) % 3], n)
                for i in range(3)
            ]
            omega_dot = times(self.inverse, [torque_body[i][n] - gyro[i] for i in range(3)])
            a, b, g = omega
            q_dot = [
                (product(w, a, n) + product(y_, g, n) - product(z, b, n)) / 2,
                (product(w, b, n) + product(z, a, n) - product(x, g, n)) / 2,
                (product(w, g, n) + product(x, b, n) - product(y_, a, n)) / 2,
                -(product(x, a, n) + product(y_, b, n) + product(z, g, n)) / 2,
            ]
            power = sum(product(force[i], velocity[i], n) + product(torque_body[i], omega[i], n) for i in range(3))
            derivative = [
                *q_dot,
                *omega_dot,
                *(velocity[i][n] for i in range(3)),
                *(force[i][n] / self.mass for i in range(3)),
                *(force[i][n] for i in range(3)),
                *(torque[i][n] for i in range(3)),
                power,
            ]
            for series, d in zip(c, derivative, strict=True):
                series.append(d / (n + 1))
        return c

    def states(self, step, order):
        """Return the unknowns at TIMES."""
        y, h, found = list(self.start), mpf(step), []
        for k in range(1, round(TIMES[-1] / h) + 1):
            y = [value(series, h) for series in self.coefficients(y, order)]
            if k * h in TIMES:
                found.append(list(y))
        return found

    def outputs(self, time, y):
        """Return what is compared: everything of the body origin, as the package gives it."""
        q, w = y[0:4], y[4:7]
        turn = rotation(q)
        arm, spin = times(turn, self.arm), times(turn, cross(w, self.arm))
        values = {
            "position_world": [a - b for a, b in zip(y[7:10], arm, strict=True)],
            "orientation_xyzw": q,
            "linear_velocity_world": [a - b for a, b in zip(y[10:13], spin, strict=True)],
            "angular_velocity_body": w,
            "impulse_world": y[13:16],
            "torque_impulse_world": y[16:19],
            "work": y[19],
        }
        texts = {k: [nstr(c, DIGITS) for c in v] if isinstance(v, list) else nstr(v, DIGITS) for k, v in values.items()}
        return {"time": time, **texts}

    def energy(self, y):
        w, v = y[4:7], y[10:13]
        return (sum(a * b for a, b in zip(w, times(self.inertia, w), strict=True)) + self.mass * mp.fdot(v, v)) / 2


def main():
    mp.dps = 60
    motion = Motion(CASE)
    coarse, fine = motion.states(STEP, ORDER), motion.states(mpf(STEP) / 2, ORDER + 5)
    agreement = max(abs(a - b) for c, f in zip(coarse, fine, strict=True) for a, b in zip(c, f, strict=True))
    balance = max(abs(motion.energy(y) - motion.energy(motion.start) - y[19]) for y in fine)
    assert agreement < mpf(10) ** -40, nstr(agreement, 3)
    assert balance < mpf(10) ** -40, nstr(balance, 3)
    document = {
        "conventions": "SI; quaternions (x, y, z, w), body to world; the initial one is normalised exactly; each input "
        "is the IEEE double nearest the decimal shown; body and world wrench are held from 0 on, forces through the "
        f"centre of mass; position and velocity are those of the body origin; states to {DIGITS} digits",
        "how": f"Taylor order {ORDER + 5}, step {STEP}/2 s, 60 digits (make_reference.py); order {ORDER} with twice "
        f"the step agrees to {nstr(agreement, 1)}, kinetic energy less work is constant to {nstr(balance, 1)} J",
        "case": CASE,
        "states": [motion.outputs(t, y) for t, y in zip(TIMES, fine, strict=True)],
    }
    TARGET.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
