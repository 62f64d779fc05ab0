"""Bounds of energy without a cause in explicit steps."""

from types import SimpleNamespace

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
    for given in (4.0, 8.0, 4.0):
        account.dissipated = given
        assert balance.gain() is None
    # a stress that the user has set between two calls
    account.dissipated = -20.0
    assert balance.gain(begins=True) is None
    account.dissipated = -24.0
    reason = balance.gain()
    assert "laws with F-bar have given back 8 J of what they dissipated" in reason
    assert "beside 10 J of first energy" in reason
    account.dissipated = float("nan")
    assert balance.gain() is None


def test_the_balance_begins_anew_after_a_failed_step():
    account = Account()
    balance = EnergyBalance(account)
    account.dissipated = 8.0
    assert balance.gain(begins=True) is None
    balance.forget()
    account.dissipated = 1.0
    assert balance.gain(begins=True) is None
    account.dissipated = -5.0
    assert "6 J" in balance.gain()
