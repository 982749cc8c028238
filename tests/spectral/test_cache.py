from pathlib import Path

import numpy as np
import pytest

from esd.common import InputError
from esd.spectral.cache import Cache, content_key, default_cache
from esd.spectral.spectrum import spectrum


def test_cache_returns_what_it_keeps_and_only_for_equal_content(tmp_path, sphere, blob):
    cache = Cache(tmp_path / "c", 10**9)
    first = spectrum(sphere, 10, cache=cache)
    again = spectrum(sphere, 10, cache=cache)
    np.testing.assert_array_equal(first.eigenvectors, again.eigenvectors)
    assert len(cache.entries()) == 1
    spectrum(blob, 10, cache=cache)
    spectrum(sphere, 11, cache=cache)
    assert len(cache.entries()) == 3
    cache.clear()
    assert cache.entries() == []


def test_damaged_entries_are_computed_again(tmp_path, sphere, caplog):
    cache = Cache(tmp_path / "c", 10**9)
    first = spectrum(sphere, 10, cache=cache)
    [(path, size)] = cache.entries()
    path.write_bytes(path.read_bytes()[: size // 2])
    again = spectrum(sphere, 10, cache=cache)
    np.testing.assert_array_equal(first.eigenvalues, again.eigenvalues)
    assert "damaged" in caplog.text


@pytest.mark.parametrize(
    "altered",
    [
        lambda arrays: {"x": arrays["mass"]},
        lambda arrays: {name: array.astype(str) for name, array in arrays.items()},
        lambda arrays: {**arrays, "eigenvalues": 2 * arrays["eigenvalues"]},
        lambda arrays: {k: v for k, v in arrays.items() if k != "digest"},
    ],
    ids=["names", "types", "content", "no digest"],
)
def test_altered_entries_are_computed_again(tmp_path, sphere, caplog, altered):
    cache = Cache(tmp_path / "c", 10**9)
    first = spectrum(sphere, 10, cache=cache)
    [(path, _)] = cache.entries()
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **altered(arrays))
    again = spectrum(sphere, 10, cache=cache)
    np.testing.assert_array_equal(first.eigenvalues, again.eigenvalues)
    assert "not those that were stored" in caplog.text
    assert spectrum(sphere, 10, cache=cache).eigenvalues.dtype == float


def test_cache_forgets_the_oldest_beyond_its_limit(tmp_path):
    cache = Cache(tmp_path / "c", 5000)
    for i in range(4):
        cache.store(content_key("x", np.array([i])), {"a": np.zeros(300)})
    assert 1 <= len(cache.entries()) < 4
    assert cache.load(content_key("x", np.array([3]))) is not None
    assert cache.load(content_key("x", np.array([0]))) is None


def test_unwritable_cache_costs_only_a_warning(tmp_path, sphere, caplog):
    (tmp_path / "file").write_text("")
    cache = Cache(tmp_path / "file", 10**9)
    assert len(spectrum(sphere, 10, cache=cache).eigenvalues) == 10
    assert "cannot be written" in caplog.text
    assert "damaged" not in caplog.text


def test_environment_chooses_the_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("ESD_CACHE", "off")
    assert default_cache() is None
    monkeypatch.setenv("ESD_CACHE", str(tmp_path))
    monkeypatch.setenv("ESD_CACHE_LIMIT", "0.5")
    assert default_cache() == Cache(tmp_path, 500_000_000)
    for limit in ("big", "inf", "nan", "-1"):
        monkeypatch.setenv("ESD_CACHE_LIMIT", limit)
        with pytest.raises(InputError, match="number of gigabytes"):
            default_cache()


def test_who_has_no_home_folder_has_no_cache(monkeypatch, caplog):
    def homeless(name: str) -> Path:
        raise RuntimeError("could not determine the home directory")

    monkeypatch.delenv("ESD_CACHE")
    monkeypatch.setattr("platformdirs.user_cache_path", homeless)
    assert default_cache() is None
    assert "name a folder in ESD_CACHE" in caplog.text
