"""``vlab modal-test``."""

import argparse

from vlab.cli.common import Outcome, text_table
from vlab.lab.run_folder import load_run
from vlab.modal.modal_test import ModalTest, run_modal_test
from vlab.outputs import output_folder, write_manifest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("run", nargs="+", help="run folders, or recordings written by vlab (.parquet, .csv)")
    parser.add_argument(
        "--input", action="append", default=[], help="input channel; by default what the recording marks as input"
    )
    parser.add_argument("--output", action="append", default=[], help="output channel; by default all sensors")
    parser.add_argument(
        "--band", type=float, nargs=2, metavar=("LOW", "HIGH"), help="band in Hz in which modes are looked for"
    )
    parser.add_argument("--modes", type=int, help="how many modes to report; by default as many as the data support")
    parser.add_argument(
        "--estimator", choices=("H1", "H2", "Hv"), default="H1", help="frequency response estimator (default H1)"
    )
    parser.add_argument(
        "--period", type=float, help="period of the excitation in s; by default what the recording says"
    )
    parser.add_argument("--segment", type=float, help="segment length in s for random data")
    parser.add_argument("--out", help="folder for figures and the responses")


def run(arguments: argparse.Namespace) -> Outcome:
    """Estimate responses and modes."""
    runs = [load_run(path) for path in arguments.run]
    test = ModalTest(
        inputs=tuple(arguments.input),
        outputs=tuple(arguments.output),
        band_hz=tuple(arguments.band) if arguments.band else None,
        n_modes=arguments.modes,
        estimator=arguments.estimator,
        period_s=arguments.period,
        segment_s=arguments.segment,
    )
    result = run_modal_test([recording for recording, _ in runs], test)
    document = result.as_dict()
    rows = [
        [i + 1, m["hz"], m["hz_sd"], m["zeta"], m["zeta_sd"], m["confidence"], *m["shape"].values()]
        for i, m in enumerate(document["modes"])
    ]
    headers = ["mode", "Hz", "sd", "zeta", "sd", "confidence", *result.mean.outputs]
    text = f"input {', '.join(result.mean.inputs)}; {result.mean.freq.size} lines; fit leaves {result.poles.residual:.2g}\n\n{text_table(headers, rows)}"
    if arguments.out:
        from vlab.views.figures import frf_figure, to_svg

        with output_folder(arguments.out) as folder:
            for name in result.mean.outputs:
                figure = frf_figure(
                    result.mean,
                    result.poles.fitted,
                    output=name,
                    input=result.mean.inputs[0],
                    labels=("measured", "fitted"),
                )
                (folder / f"frf-{name.replace(':', '-')}.svg").write_text(to_svg(figure), encoding="utf-8")
            write_manifest(folder, verb="modal-test", runs=[str(path) for path in arguments.run])
        document["out"] = str(arguments.out)
    return Outcome(document=document, text=text)
