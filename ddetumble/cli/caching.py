"""The command about compiled programs kept on disk: `cache`."""

import typer


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    cache = typer.Typer(rich_markup_mode=None)
    cache.command("show", epilog="\b\nExample:\n  ddetumble cache show")(show_cache)
    cache.command("clear", epilog="\b\nExample:\n  ddetumble cache clear")(remove_cache)
    cache.callback(invoke_without_command=True)(choose_action)
    app.add_typer(cache, name="cache", epilog="\b\nExample:\n  ddetumble cache clear")


def choose_action(context: typer.Context):
    """Compiled programs kept on disk: show or clear them."""
    if context.invoked_subcommand is None:
        show_cache()


def show_cache():
    """Say where compiled programs are kept, how many there are, and their size. DDETUMBLE_CACHE=off keeps none."""
    from .._settings import describe_cache

    typer.echo(describe_cache())


def remove_cache():
    """Remove all compiled programs; the next commands take longer and fill the cache again."""
    from .._settings import clear_cache, find_cache

    count, size = clear_cache()
    typer.echo(f"{find_cache()}: {count} compiled programs removed, {size / 1e6:.1f} MB")
