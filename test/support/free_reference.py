"""Free rotation in many digits, by Legendre's forms, whose cancellation does not matter there."""

from __future__ import annotations

from collections.abc import Sequence

import mpmath as mp


def _product(p, q):
    px, py, pz, pw = p
    qx, qy, qz, qw = q
    return (
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
        pw * qw - px * qx - py * qy - pz * qz,
    )


def free_rotation(moments: Sequence[float], spin: Sequence[float], t: float, digits: int = 80):
    """Return quaternion (from attitude 1) and angular velocity after t s, in principal axes (Landau & Lifshitz, 37)."""
    with mp.workdps(digits):
        i = [mp.mpf(a) for a in moments]
        w = [mp.mpf(a) for a in spin]
        t = mp.mpf(t)
        low, middle, high = sorted(range(3), key=lambda k: i[k])
        t2 = sum(m * x * x for m, x in zip(i, w, strict=True))
        l2 = sum((m * x) ** 2 for m, x in zip(i, w, strict=True))
        momentum = mp.sqrt(l2)
        if all((i[(k + 1) % 3] - i[(k + 2) % 3]) * w[(k + 1) % 3] * w[(k + 2) % 3] == 0 for k in range(3)):
            rate = mp.sqrt(sum(x * x for x in w))
            if rate == 0:
                return [mp.mpf(0)] * 3 + [mp.mpf(1)], w
            return [x / rate * mp.sin(rate * t / 2) for x in w] + [mp.cos(rate * t / 2)], w
        a, b, c = (low, middle, high) if l2 - t2 * i[middle] >= 0 else (high, middle, low)
        ia, ib, ic = i[a], i[b], i[c]
        sign_c = 1 if w[c] >= 0 else -1
        sign_a = 1 if w[a] >= 0 else -1
        sign_b = (1 if (b - a) % 3 == 1 else -1) * sign_a * sign_c
        wa, wb = sign_a * w[a], sign_b * w[b]
        top_a = mp.sqrt((t2 * ic - l2) / (ia * (ic - ia)))
        top_b = mp.sqrt((t2 * ic - l2) / (ib * (ic - ib)))
        top_c = mp.sqrt((l2 - t2 * ia) / (ic * (ic - ia)))
        rate = mp.sqrt((ic - ib) * (l2 - t2 * ia) / (ia * ib * ic)) * (1 if ic > ia else -1)
        m = (ib - ia) * (t2 * ic - l2) / ((ic - ib) * (l2 - t2 * ia))
        n = -ic * (ib - ia) / (ia * (ic - ib))
        start = mp.atan2(wb / top_b, wa / top_a) if top_a else mp.mpf(0)
        quarter = mp.ellipk(m)
        u = mp.ellipf(start, m) + rate * t
        turns = int(mp.nint(u / (2 * quarter)))
        sn, cn, dn = (mp.ellipfun(name, u - 2 * turns * quarter, m=m) for name in ("sn", "cn", "dn"))
        azimuth = 2 * turns * mp.ellippi(n, m) + mp.ellippi(n, mp.atan2(sn, cn), m) - mp.ellippi(n, start, m)
        phi = momentum * t / ic + momentum * (ic - ia) / (ia * ic * rate) * azimuth
        sign = -1 if turns % 2 else 1
        now = (top_a * cn * sign, top_b * sn * sign, top_c * dn)

        def about_c(angle):
            return (mp.mpf(0), mp.mpf(0), mp.sin(angle / 2), mp.cos(angle / 2))

        def about_b(angle):
            return (mp.mpf(0), mp.sin(angle / 2), mp.mpf(0), mp.cos(angle / 2))

        ratio = mp.sqrt(ib * (ic - ia) / (ia * (ic - ib)))
        chi0, chi = mp.atan2(ratio * mp.sin(start), mp.cos(start)), mp.atan2(ratio * sn * sign, cn * sign)
        theta0 = mp.atan2(mp.hypot(ia * wa, ib * wb), ic * sign_c * w[c])
        theta = mp.atan2(mp.hypot(ia * now[0], ib * now[1]), ic * now[2])
        q = _product(
            _product(_product(about_c(chi0), about_b(theta0)), about_c(phi)), _product(about_b(-theta), about_c(-chi))
        )
        turn, omega = [mp.mpf(0)] * 3 + [q[3]], [mp.mpf(0)] * 3
        for index, sign, x, y in ((a, sign_a, q[0], now[0]), (b, sign_b, q[1], now[1]), (c, sign_c, q[2], now[2])):
            turn[index], omega[index] = sign * x, sign * y
        return turn, omega


def angle(p, q) -> float:
    """Return the angle (rad) between a reference attitude p and a computed one q."""
    with mp.workdps(60):
        q = [mp.mpf(c) for c in q]
        x, y, z, _ = _product((-p[0], -p[1], -p[2], p[3]), q)
        return float(2 * mp.asin(min(mp.mpf(1), mp.sqrt(x * x + y * y + z * z) / mp.sqrt(sum(c * c for c in q)))))
