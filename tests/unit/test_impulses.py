"""Motion with contact impulses: coefficients and mass ratios from simulated bodies."""

import numpy as np
import pytest

from experiments.impulses import Contacts, MotionNoise, motion_evidence


def collide(masses, pull, drag, n=240, seed=0, sigma=0.3):
    """Two discs in a box, elastic collisions, uniform pull along x over m, drag per second."""
    rng = np.random.default_rng(seed)
    p = np.array([[60.0, 100.0], [200.0, 110.0]])
    v = np.array([[2.0, 0.3], [-1.5, -0.2]])
    radius, size, masses = 20.0, 260.0, np.asarray(masses, dtype=float)
    places, pairs, walls = [], [], np.zeros((n, 2, 2), dtype=bool)
    for t in range(n):
        places.append(p.copy())
        a = np.stack([pull / masses, np.zeros(2)], axis=1) - drag * v
        v = v + 0.5 * a
        p = p + v
        v = v + 0.5 * a
        d = p[1] - p[0]
        r = np.linalg.norm(d)
        pairs.append(((0, 1, d / r),) if r < 2 * radius + 6 else ())
        if r < 2 * radius and (v[1] - v[0]) @ d < 0:
            j = 2 * ((v[1] - v[0]) @ d / r) / (1 / masses).sum()
            v[0] += j * d / r / masses[0]
            v[1] -= j * d / r / masses[1]
        for k in range(2):
            for axis in range(2):
                walls[t, k, axis] = not radius + 6 < p[k, axis] < size - radius - 6
                if (
                    p[k, axis] < radius
                    and v[k, axis] < 0
                    or (p[k, axis] > size - radius and v[k, axis] > 0)
                ):
                    v[k, axis] *= -1
    z = np.array(places)
    true_v = np.gradient(z, axis=0)
    z = z + rng.normal(0, sigma, z.shape)
    slip = np.zeros_like(z)
    touching = walls.any(axis=2) | np.array([[len(q) > 0] * 2 for q in pairs])
    slip[touching] = 1.0
    contacts = Contacts(tuple(pairs), walls, slip, np.zeros((n, 2), dtype=bool))
    features = np.zeros((n, 2, 2, 3))
    features[:, 0, 0, 0] = features[:, 1, 0, 1] = 1.0
    features[..., 2] = -true_v
    return z, features, contacts


NOISE = MotionNoise(position=0.3, velocity=1e-3, normal=5.0, tangential=0.02)


def test_mass_ratio_comes_from_the_recoil():
    z, features, contacts = collide((1.0, 3.0), 0.0, 0.0)
    hypotheses = np.array([[1.0, 1 / 3], [1.0, 1.0], [1.0, 3.0], [1.0, 9.0]])
    evidence = motion_evidence(z, features * 0, contacts, hypotheses, NOISE)
    assert np.argmax(evidence.constant) == 2
    others = np.delete(evidence.constant, 2)
    assert evidence.constant[2] - others.max() > 20


def test_coefficients_are_recovered_within_their_errors():
    off = []
    for seed in range(6):
        z, features, contacts = collide((1.0, 3.0), 0.03, 0.004, seed=seed)
        evidence = motion_evidence(z, features, contacts, np.array([[1.0, 3.0]]), NOISE)
        c, covariance = evidence.estimate()
        off.append((c - (0.03, 0.01, 0.004)) / np.sqrt(np.diag(covariance)))
    off = np.array(off)
    assert np.abs(off).max() < 4.5
    assert np.sqrt(np.mean(off**2)) < 1.8


def test_innovations_are_standard_normal_under_the_truth():
    z, features, contacts = collide((1.0, 3.0), 0.03, 0.004, seed=11)
    evidence = motion_evidence(z, features, contacts, np.array([[1.0, 3.0]]), NOISE)
    residuals = evidence.residuals(np.array([0.03, 0.01, 0.004]))[3:]
    assert np.mean(residuals**2) == pytest.approx(1.0, abs=0.2)


def test_likelihood_is_quadratic_in_the_coefficients():
    z, features, contacts = collide((1.0, 1.0), 0.03, 0.0)
    masses = np.ones((1, 2))
    evidence = motion_evidence(z, features, contacts, masses, NOISE)
    c = np.array([0.01, -0.02, 0.003])
    moved = z.copy()
    direct = motion_evidence(
        moved,
        np.concatenate([features, (features @ c)[..., None]], axis=3),
        contacts,
        masses,
        NOISE,
    )
    whole = np.array([0.0, 0.0, 0.0, 1.0])
    value = direct.constant + direct.b @ whole - 0.5 * whole @ direct.gram[0] @ whole
    expected = evidence.constant + evidence.b @ c - 0.5 * c @ evidence.gram[0] @ c
    np.testing.assert_allclose(value, expected, rtol=1e-9)


def test_gaps_and_only_ratios_matter():
    z, features, contacts = collide((1.0, 3.0), 0.0, 0.0)
    z[40:60, 0] = np.nan
    evidence = motion_evidence(z, features, contacts, np.array([[1.0, 3.0], [3.0, 9.0]]), NOISE)
    assert np.isfinite(evidence.constant).all()
    np.testing.assert_allclose(evidence.constant[0], evidence.constant[1], rtol=1e-10)
