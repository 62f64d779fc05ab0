"""Bounds of energy without a cause in explicit steps."""

from types import SimpleNamespace

import numpy as np
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.dynamics.energybounds import EnergyBalance


class Account:
    """Energies of a run that has 10 J at first, of which laws dissipate some."""

    def __init__(self):
        self.dissipated = 0.0
        self.work = SimpleNamespace(internal=0.0, external=0.0, pending=0.0)

    def moving(self):
        return 10.0 - self.work.internal

    def energies(self):
        return SimpleNamespace(strain=0.0)


def test_laws_with_fbar_give_nothing_back():
    account = Account()
    balance = EnergyBalance(account)
    assert balance.gain(begins=True) is None
    for given in (0.0, 4.0, 8.0, 4.0):
        account.dissipated = given
        assert balance.given_back() is None
    account.dissipated = float("nan")
    assert balance.given_back() is None
    account.dissipated = 2.0
    reason = balance.given_back()
    assert "laws with F-bar have given back 6 J of what they dissipated" in reason
    assert "beside 10 J of first energy" in reason
    for forget in (balance.touched, balance.forget):
        forget()
        balance.gain()
        account.dissipated -= 20.0
        assert balance.given_back() is None
        account.dissipated -= 6.0
        assert "6 J" in balance.given_back()


def test_a_stress_that_a_user_sets_is_not_given_back():
    """The block rests, and laws with F-bar are looked at within each call."""
    lines = [np.arange(5) * 0.25] * 2
    points = mpm.fill(mpm.create_lattice(MPI.COMM_WORLD, lines), mpm.Box((0, 0), (1, 0.5)), 2, 1e3)
    V = mpm.Space(points.grid, "gimp")
    law = mpm.materials.VonMises(E=1e6, nu=0.3, radius=1e6)
    F = mpm.momentum(law, points, V.increment, V.test, fbar=True)
    problem = mpm.Explicit(F, V.increment, points, mpm.fixed(V, lambda x: x[0] > -1.0))
    points["velocity"] = np.tile((0.0, -0.1), (len(points), 1))
    seen = []
    balance = problem.balance
    given_back = balance.given_back
    balance.given_back = lambda: seen.append(given_back()) or seen[-1]
    steps = 120 * problem.courant * problem.critical_step()
    for k, pressure in enumerate((0.0, 1e5, 0.0, 2e5)):
        mpm.set_stress(law, points, -pressure * np.eye(3))
        problem.step((k + 1) * steps)
    assert len(seen) >= 4
    assert not any(seen)
