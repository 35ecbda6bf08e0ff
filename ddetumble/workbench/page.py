"""The page of the workbench, a marimo app: cells that show a bench and its controls, and call what `bench` does.

`ddetumble workbench CAMPAIGN` opens it. Texts come from files: they are escaped wherever HTML is made of them.
"""

import marimo


app = marimo.App(width="full", app_title="ddetumble workbench")

with app.setup:
    import base64
    import html
    import time
    from concurrent.futures import ThreadPoolExecutor
    from typing import Any

    import marimo as mo

    import ddetumble as dd
    from ddetumble.workbench import bench as wb

    SMALL = "font-size: 0.8rem"


@app.function
def say(text, style=""):
    """A paragraph of text as it stands."""
    return mo.Html(f'<p style="overflow-wrap: anywhere; {style}">{html.escape(str(text))}</p>')


@app.function
def code(text):
    """Python lines, to be copied."""
    return mo.Html('<pre style="overflow-x: auto; font-size: 0.8rem; padding: 0.6rem; background: #8881"><code>'
                   f"{html.escape(text)}</code></pre>")


@app.function
def row(*parts, flex="0 1 auto"):
    """Parts side by side, or one below the other where the window is narrow."""
    inside = "".join(f'<div style="flex: {flex}; min-width: 0">{mo.as_html(part).text}</div>' for part in parts)
    return mo.Html('<div style="display: flex; flex-wrap: wrap; gap: 1rem 2rem; align-items: flex-start">'
                   f"{inside}</div>")


@app.function
def show(draw, *arguments, alt, narrow=True):
    """A figure, and the one for a telephone where the window is narrow (if there is one)."""
    # The one for the other kind of window has no width: what is drawn late may bring neither style sheets nor `srcset`.
    looks = [({}, "100vw - 640px"), ({"narrow": True}, "640px - 100vw")] if narrow else [({}, "100vw")]
    pictures = [(base64.b64encode(dd.figures.render_png(draw(*arguments, **look))).decode(), room)
                for look, room in looks]
    return mo.Html("".join(
        f'<img src="data:image/png;base64,{picture}" alt="{html.escape(alt)}" '
        f'style="max-width: clamp(0px, ({room}) * 9999, 100%); max-height: 75vh">' for picture, room in pictures))


@app.function
def attempt(title, work, *arguments) -> tuple[Any, Any]:
    """Do long work under a bar; returns its result, or None and a box that says why it was refused."""
    told = [title, 0.0]

    def report(text, share):
        told[:] = text, share

    try:
        with (mo.status.progress_bar(total=100, title=title, show_eta=False, show_rate=False, remove_on_exit=True)
              as bar, ThreadPoolExecutor(1) as pool):
            # Work that tells of itself from threads of its own could not write to the page.
            future, done = pool.submit(work, *arguments, report), 0
            while not future.done():
                now = int(100 * told[1]) if told[1] == told[1] else done
                bar.update(max(now - done, 0), subtitle=html.escape(str(told[0])))
                done = max(now, done)
                time.sleep(0.2)
        return future.result(), None
    except (dd.InputError, dd.ComputationError) as error:
        return None, mo.callout(say(error), kind="danger")


@app.cell
def _():
    _given = mo.cli_args()
    _started, _refused = attempt("reading the campaign and fitting the model", wb.open_bench,
                                 str(_given.get("campaign")), str(_given.get("model") or "paper"))
    mo.stop(_started is None, _refused)
    get_bench, set_bench = mo.state(_started)
    _campaign = _started.campaign
    _keys = [str(key) for key in _campaign.record_keys]
    record = mo.ui.dropdown(_keys, value=_keys[0], label="Record")
    mo.vstack([say(_campaign.title or _campaign.name, "font-size: 1.5rem; padding-right: 3rem"),
               say(f"{_campaign.name}: {len(_keys)} records. Below each action stand the Python lines that do the "
                   "same.")])
    return get_bench, record, set_bench


@app.cell
def _(get_bench):
    bench = get_bench()
    effects = mo.ui.multiselect(list(wb.list_effects(bench)), value=list(bench.step.effects),
                                label="Effects in the model", full_width=True)
    return bench, effects


@app.cell
def _(bench, effects):
    controls = wb.list_controls(bench, effects.value)
    values = mo.ui.dictionary({one.name: (
        mo.ui.slider(one.low, one.high, one.step, one.shown, debounce=True, include_input=True,
                     full_width=True) if one.slides else
        mo.ui.number(value=one.shown, step=one.step, debounce=True, full_width=True))
        for one in controls})
    fitted = mo.ui.dictionary({one.name: mo.ui.checkbox(value=one.fitted, label="fit") for one in controls})
    fit_button = mo.ui.run_button(label="Fit", kind="success")
    return controls, fit_button, fitted, values


@app.cell
def _(bench, controls, effects, fit_button, fitted, record, refused, trial, values):
    shown = {bench.step.name: bench.step.errors.traces}
    if trial is not None:
        shown["where the controls stand"] = trial.result.traces
    _errors = bench.step.errors if trial is None else trial.result
    _laws = [say(f"{name}: {wb.list_effects(bench)[name].law}", SMALL) for name in effects.value]
    _rows = [mo.vstack([say(one.tell(values.value[one.name]), SMALL),
                        mo.hstack([values[one.name], fitted[one.name]], widths=[4, 1], align="center")], gap=0)
             for one in sorted(controls, key=lambda one: "." not in one.name)]  # effects first
    _told = say(f"{'This step' if trial is None else 'Where the controls stand'}: error {100 * _errors.nrmse:.2f} %; "
                f"noise alone makes {100 * _errors.noise_nrmse:.2f} %.", SMALL)
    _one = {name: [trace for trace in traces if trace.record == record.value] for name, traces in shown.items()}
    _pictures = [
        show(dd.figures.draw_values, shown, channel, alt=f"Measured and modelled {channel} of every record.")
        if bench.are_values else
        show(dd.figures.draw_fit, _one, channel, 1, alt=f"Measured and modelled {channel}, with the residual below.",
             narrow=False)
        for channel in bench.channels]
    row(mo.vstack([mo.md("## The model"), effects, *_laws, *_rows, fit_button, _told, *([refused] if refused else [])]),
        mo.vstack([*([] if bench.are_values else [record]), *_pictures, *([code(trial.code)] if trial else [])]),
        flex="1 1 20rem")
    return (shown,)


@app.cell
def _(bench, controls, effects, values):
    trial, refused = attempt("computing the model where the controls stand", wb.simulate, bench,
                             wb.choose(controls, effects.value, values.value, {}))
    return refused, trial


@app.cell
def _(bench, controls, effects, fit_button, fitted, set_bench, values):
    mo.stop(not fit_button.value)
    _new, _refused = attempt("fitting", wb.fit, bench, wb.choose(controls, effects.value, values.value, fitted.value))
    mo.stop(_new is None, _refused)
    set_bench(_new)
    return


@app.cell
def _(bench, set_bench):
    _found = bench.step.found
    back = mo.ui.dropdown({one.name: one.number for one in bench.steps}, value=bench.step.name,
                           label="Look at, and go on from, step",
                           on_change=lambda number: number and set_bench(bench.go_back(number)))
    mo.vstack([
        mo.md("## The error ledger"),
        mo.ui.table(wb.list_errors(bench), selection=None, show_column_summaries=False, show_data_types=False,
                    show_download=False, show_search=False, wrapped_columns=["done"]),
        back,
        show(dd.figures.draw_error_by_step, [one.errors for one in bench.steps], [one.name for one in bench.steps],
             bench.step.errors.noise_nrmse, alt="Error by step, fitted and cross-validated, with the noise floor."),
        say(_found.sentence if _found else bench.step.errors.sentence),
        *([show(dd.figures.draw_ranking, _found.candidates, _found.effects,
                alt="How much of the misfit each effect explains.")] if _found and _found.candidates else []),
        code(wb.write_step(bench)),
        mo.accordion({"This step in full": mo.plain_text(str(bench.step.fit)),
                      "All steps as a script": code(wb.write_script(bench))})])
    return (back,)


@app.cell
def _(bench, shown):
    mo.stop(bench.are_values)  # whose residuals are all seen beside the measurements
    mo.vstack([mo.md("## Where the residuals sit"), mo.lazy(lambda: mo.vstack([  # drawn where it is scrolled to
        *(show(dd.figures.draw_dependence, shown, channel, bench.step.errors.noise.get(channel),
               bench.step.errors.where, alt=f"Mean residual of {channel} by state and condition.")
          for channel in bench.channels),
        show(dd.figures.draw_record_errors, shown, alt="Error over the noise by condition.")]),
        show_loading_indicator=True)])
    return


@app.cell
def _(bench):
    discover_button = mo.ui.run_button(label="Discover")
    missing_button = mo.ui.run_button(label="Draw the missing force")
    design_button = mo.ui.run_button(label="Find the next test")
    rival = mo.ui.dropdown({one.name: one.number for one in bench.steps if one.number != bench.current},
                           label="that tells this step from")
    folder = mo.ui.text(value=f"{bench.campaign.name}-workbench", label="to the new folder")
    save_button = mo.ui.run_button(label="Save")
    mo.vstack([mo.md("## Go on from this step"),
               row(discover_button, missing_button, row(design_button, rival), row(save_button, folder))])
    return design_button, discover_button, folder, missing_button, rival, save_button


@app.cell
def _(bench, discover_button, set_bench):
    mo.stop(not discover_button.value)
    _new, _refused = attempt("looking for what is missing", wb.discover, bench)
    mo.stop(_new is None, _refused)
    set_bench(_new)
    return


@app.cell
def _(bench, missing_button):
    mo.stop(not missing_button.value)
    _done, _refused = attempt("drawing the missing force", wb.draw_missing, bench)
    mo.stop(_done is None, _refused)
    _shape = [show(dd.figures.draw_missing_shape, _done.result, alt="The missing force over its variable.")]
    mo.vstack([mo.md("## The missing force"), say(_done.result.sentence), *(_shape if _done.result.shapes else []),
               code(_done.code)])
    return


@app.cell
def _(bench, design_button, rival):
    mo.stop(not design_button.value)
    _done, _refused = attempt("looking for the next test", wb.design, bench, rival.value)
    mo.stop(_done is None, _refused)
    mo.vstack([mo.md("## The next test"), say(_done.result.sentence),
               show(dd.figures.draw_next_test, _done.result, alt="What each model predicts of the next test.",
                    narrow=False), code(_done.code)])
    return


@app.cell
def _(bench, folder, save_button):
    mo.stop(not save_button.value)
    _done, _refused = attempt("saving", wb.save, bench, folder.value)
    mo.stop(_done is None, _refused)
    mo.vstack([say(f"Saved to {_done.result}, where comparison.html is the report of all steps."), code(_done.code)])
    return


if __name__ == "__main__":
    app.run()
