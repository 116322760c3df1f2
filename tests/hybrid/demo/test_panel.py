"""What is chosen with the controls is always a valid setting."""

from __future__ import annotations

import pytest

from hybrid.interactive.request import Settings


@pytest.fixture(scope="module")
def application(offscreen) -> object:
    from PySide6.QtWidgets import QApplication

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("QT_QPA_PLATFORM", offscreen["QT_QPA_PLATFORM"])
        return QApplication.instance() or QApplication([])


def test_what_was_asked_for_is_kept_until_something_is_changed(application):
    from hybrid.demo.panel import Panel

    asked = Settings(12.4, 11.25, 32, "fov-gs", None, 1, 0.5, 24.5)
    panel = Panel(asked, 4)
    chosen = panel.settings()
    assert (chosen.fov_a, chosen.fov_b, chosen.spp, chosen.target_fps) == (12.4, 11.25, 32, 24.5)
    assert chosen.layers == (1, 4)
    panel.acuity_model.setCurrentText("none")
    assert panel.settings().acuity_model == "none"


def test_no_one_hears_of_a_setting_that_is_not_valid(application):
    from hybrid.demo.panel import Panel

    panel = Panel(Settings(15.0, 11.0), 4)
    heard = []
    panel.changed.connect(lambda: heard.append(panel.settings()))
    for value in (40, 5, 60, 0, 30):
        panel.fov_a.setValue(value)
    for value in (50, 10):
        panel.fov_b.setValue(value)
    for value in (1, 3):
        panel.finest.setValue(value)
    panel.coarsest.setValue(4)
    assert len(heard) >= 10
    for settings in heard:
        assert settings.fov_b <= settings.fov_a
        assert settings.layers[0] <= settings.layers[1]
    assert heard[-1].layers == (4, 4)
