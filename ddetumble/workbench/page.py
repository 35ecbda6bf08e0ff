"""The page of the workbench, a marimo app: cells that show a bench and its controls, and call what `bench` does.

`ddetumble workbench CAMPAIGN` opens it. Texts come from files: they are escaped wherever HTML is made of them.
"""

import marimo


app = marimo.App(width="full", app_title="ddetumble workbench")


@app.cell
def _():
    import base64
    import html
    import time
    from concurrent.futures import ThreadPoolExecutor

    import marimo as mo

    import ddetumble as dd
    from ddetumble.workbench import bench as wb

    def say(text, tag="p"):
        """Text as it stands."""
        return mo.Html(f"<{tag}>{html.escape(str(text))}</{tag}>")

    def show(draw, *arguments, alt, **options):
        """A figure, and the one for a telephone where the window is narrow."""
        wide, narrow = (base64.b64encode(dd.figures.render_png(draw(*arguments, **options, **more))).decode()
                        for more in ({}, {"narrow": True}))
        return mo.Html(
            f'<picture><source media="(max-width: 640px)" srcset="data:image/png;base64,{narrow}">'
            f'<img src="data:image/png;base64,{wide}" alt="{html.escape(alt)}" '
            'style="max-width: 100%; max-height: 75vh; height: auto"></picture>')

    def code(text):
        """Python lines, to be copied."""
        return mo.Html(f'<pre style="overflow-x: auto; font-size: 0.8rem; padding: 0.6rem; background: #8881">'
                       f"<code>{html.escape(text)}</code></pre>")

    def attempt(title, work, *arguments):
        """Do long work with a bar; returns its result, or None and what to show where it was refused."""
        told = [title, 0.0]
        try:
            with (mo.status.progress_bar(total=100, title=title, show_eta=False, show_rate=False, remove_on_exit=True)
                  as bar, ThreadPoolExecutor(1) as pool):
                # The work tells of itself from threads of its own, which cannot write to the page.
                future, done = pool.submit(work, *arguments, lambda *now: told.__setitem__(slice(None), now)), 0
                while not future.done():
                    now = int(100 * told[1]) if told[1] == told[1] else done
                    bar.update(max(now - done, 0), subtitle=html.escape(str(told[0])))
                    done = max(now, done)
                    time.sleep(0.2)
            return future.result(), None
        except (dd.InputError, dd.ComputationError) as error:
            return None, mo.callout(say(error), kind="danger")

    return attempt, code, dd, mo, say, show, wb


@app.cell
def _(attempt, mo, wb):
    _given = mo.cli_args()
    _started, _refused = attempt("reading the campaign and fitting the model", wb.open_bench,
                                 str(_given.get("campaign")), str(_given.get("model") or "paper"))
    mo.stop(_started is None, _refused)
    get_bench, set_bench = mo.state(_started)
    return get_bench, set_bench


@app.cell
def _(get_bench, mo, say):
    _campaign = get_bench().campaign
    mo.vstack([say(_campaign.title or _campaign.name, "h1"),
               say(f"{_campaign.name}: {len(_campaign.records)} records, {', '.join(_campaign.channels)}. "
                   "Every picture is of the step that is looked at; below each action stand the Python lines that do "
                   "the same.")])
    return


@app.cell
def _(get_bench, mo, wb):
    bench = get_bench()
    record = mo.ui.dropdown([str(key) for key in bench.campaign.record_keys], value=str(bench.campaign.record_keys[0]),
                            label="Record")
    effects = mo.ui.multiselect(list(wb.list_effects(bench)), value=list(bench.step.effects),
                                label="Effects in the model", full_width=True)
    return bench, effects, record


@app.cell
def _(bench, effects, mo, wb):
    controls = wb.list_controls(bench, effects.value)
    values = mo.ui.dictionary({one.name: (
        mo.ui.slider(one.low, one.high, (one.high - one.low) / 200, one.value, debounce=True, include_input=True,
                     full_width=True) if one.slides else
        mo.ui.number(value=one.value, debounce=True, full_width=True)) for one in controls})
    fitted = mo.ui.dictionary({one.name: mo.ui.checkbox(value=one.fitted, label="fit") for one in controls})
    fit_button = mo.ui.run_button(label="Fit", kind="success")
    return controls, fit_button, fitted, values


@app.cell
def _(attempt, bench, controls, effects, fitted, values, wb):
    choice = wb.choose(controls, effects.value, values.value, fitted.value)
    trial, refused = attempt("computing the model where the controls stand",
                             lambda progress: wb.simulate(bench, choice))
    return choice, refused, trial


@app.cell
def _(bench, code, controls, dd, effects, fit_button, fitted, mo, record, refused, say, show, trial, values):
    shown = {bench.step.name: bench.step.errors.traces}
    if trial is not None:
        shown["where the controls stand"] = trial.result.traces
    _rows = [mo.vstack([say(one.label, "small"),
                        mo.hstack([values[one.name], fitted[one.name]], widths=[4, 1], align="center")], gap=0)
             for one in controls]
    _errors = bench.step.errors if trial is None else trial.result
    _panel = mo.vstack([
        say("The model", "h2"), effects, *_rows, mo.hstack([fit_button], justify="start"),
        say(f"{'The step' if trial is None else 'Where the controls stand'}: error {100 * _errors.nrmse:.2f} %, of which "
            f"noise alone makes {100 * _errors.noise_nrmse:.2f} %.", "small"), *([refused] if refused else [])])
    _one = {name: [trace for trace in traces if trace.record == record.value] for name, traces in shown.items()}
    _value = all(trace.is_value for trace in bench.step.errors.traces)
    _pictures = [show(dd.figures.draw_values, shown, alt="Measured and modelled values.")] if _value else [
        show(dd.figures.draw_fit, _one, channel, 1, alt=f"Measured and modelled {channel}; residual below.")
        for channel in bench.campaign.channels]
    mo.hstack([_panel, mo.vstack([record, *_pictures, *([code(trial.code)] if trial else [])])],
              widths=[2, 3], wrap=True, align="start", gap=2)
    return (shown,)


@app.cell
def _(attempt, bench, choice, fit_button, mo, set_bench, wb):
    mo.stop(not fit_button.value)
    _new, _refused = attempt("fitting", wb.fit, bench, choice)
    if _new is not None:
        set_bench(_new)
    _refused
    return


@app.cell
def _(bench, code, dd, mo, say, set_bench, show, wb):
    _back = mo.ui.dropdown({one.name: one.number for one in bench.steps}, value=bench.step.name,
                           label="Look at, and go on from, step",
                           on_change=lambda number: number and set_bench(bench.go_back(number)))
    mo.vstack([
        say("The error ledger", "h2"),
        mo.ui.table(wb.list_errors(bench), selection=None, show_column_summaries=False, show_data_types=False,
                    show_download=False),
        _back,
        show(dd.figures.draw_error_by_step, [one.name for one in bench.steps], [one.errors for one in bench.steps],
             bench.step.errors.noise_nrmse, alt="Error by step, fitted and cross-validated, with the noise floor."),
        say(bench.step.found.sentence if bench.step.found else bench.step.errors.sentence),
        *([show(dd.figures.draw_ranking, bench.step.found.candidates, bench.step.found.effects,
                alt="How much of the misfit each effect explains.")]
          if bench.step.found and bench.step.found.candidates else []),
        code(wb.write_step(bench)), mo.accordion({"The step in full": mo.plain_text(str(bench.step.fit)),
                                                  "All steps as a script": code(wb.write_script(bench))})])
    return


@app.cell
def _(bench, dd, mo, say, show, shown):
    mo.stop(all(trace.is_value for trace in bench.step.errors.traces))
    mo.vstack([
        say("Where the residuals sit", "h2"),
        *(show(dd.figures.draw_dependence, shown, channel, bench.step.errors.noise.get(channel),
               bench.step.errors.where, alt=f"Mean residual of {channel} by state and condition.")
          for channel in bench.campaign.channels),
        show(dd.figures.draw_record_errors, shown, alt="Error over the noise by condition.")])
    return


@app.cell
def _(bench, mo, say):
    discover_button = mo.ui.run_button(label="Discover", tooltip="Go on from this step by itself")
    missing_button = mo.ui.run_button(label="Draw the missing force")
    rival = mo.ui.dropdown({one.name: one.number for one in bench.steps if one.number != bench.current},
                           label="apart from step")
    design_button = mo.ui.run_button(label="Find the next test")
    folder = mo.ui.text(value=f"{bench.campaign.name}-workbench", label="Folder")
    save_button = mo.ui.run_button(label="Save")
    mo.vstack([say("Go on from this step", "h2"), mo.hstack(
        [discover_button, missing_button, mo.hstack([design_button, rival], justify="start"),
         mo.hstack([folder, save_button], justify="start")], justify="start", wrap=True, gap=1.5)])
    return design_button, discover_button, folder, missing_button, rival, save_button


@app.cell
def _(attempt, bench, discover_button, mo, set_bench, wb):
    mo.stop(not discover_button.value)
    _new, _refused = attempt("looking for what is missing", wb.discover, bench)
    if _new is not None:
        set_bench(_new)
    _refused
    return


@app.cell
def _(attempt, bench, code, dd, missing_button, mo, say, show, wb):
    mo.stop(not missing_button.value)
    _done, _refused = attempt("drawing the missing force", wb.draw_missing, bench)
    mo.stop(_done is None, _refused)
    mo.vstack([say("The missing force", "h2"), say(_done.result.sentence), *(
        [show(dd.figures.draw_missing_shape, _done.result, alt="The missing force over its variable.")]
        if _done.result.shapes else []), code(_done.code)])
    return


@app.cell
def _(attempt, bench, code, dd, design_button, mo, rival, say, show, wb):
    mo.stop(not design_button.value)
    _done, _refused = attempt("looking for the next test", wb.design, bench, rival.value)
    mo.stop(_done is None, _refused)
    mo.vstack([say("The next test", "h2"), say(_done.result.sentence),
               show(lambda found, narrow=False: dd.figures.draw_next_test(found), _done.result,
                    alt="What each model predicts of the next test."), code(_done.code)])
    return


@app.cell
def _(attempt, bench, code, folder, mo, save_button, say, wb):
    mo.stop(not save_button.value)
    _done, _refused = attempt("saving", lambda progress: wb.save(bench, folder.value))
    mo.stop(_done is None, _refused)
    mo.vstack([say(f"Saved to {_done.result}; comparison.html there is the report of all steps."), code(_done.code)])
    return


if __name__ == "__main__":
    app.run()
