"""`esd cache`."""

from __future__ import annotations

from typing import Annotated

import typer


def cache(
    clear: Annotated[bool, typer.Option("--clear", help="Remove everything in it.")] = False,
) -> None:
    """Show or clear the cache of computed spectra.

    ESD_CACHE names another folder, or is 'off'; ESD_CACHE_LIMIT is its size in gigabytes.
    """
    from esd.spectral.cache import default_cache

    store = default_cache()
    if store is None:
        typer.echo("The cache is off (ESD_CACHE=off).")
        return
    if clear:
        store.clear()
    entries = store.entries()
    size = sum(size for _, size in entries) / 1e6
    typer.echo(f"{store.folder}: {len(entries)} entries, {size:.0f} of {store.limit / 1e6:.0f} MB")
