import pytest

from esd.common import InputError
from esd.learning.model import load_model


def test_unusable_devices_are_refused(monkeypatch):
    with pytest.raises(InputError, match="There is no device 'tpu'"):
        load_model("default", device="tpu")
    torch = pytest.importorskip("torch", reason="other devices need the extra `train`")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert load_model("hks", device="auto").device == "cpu"
    with pytest.raises(InputError, match="torch finds no GPU here"):
        load_model("hks", device="cuda")
