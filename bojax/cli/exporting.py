"""`bojax export`: finished results as CSV files or as runs of TensorBoard, Weights & Biases or MLflow."""

from collections.abc import Sequence

from bojax.cli.parser import Parser, one_of, path

TARGETS = ("csv", "mlflow", "tensorboard", "wandb")
"""What results can be exported to; `bojax.report.exporting.build` has a function for each."""

_EXAMPLES = """\
  bojax export results/chain/20250101-120000 --to csv              CSV files in its subfolder export/csv
  bojax export results/chain/20250101-120000 --to tensorboard      event files
  bojax export results/chain/20250101-120000 --to wandb --out runs
"""

_DESCRIPTION = """\
Export a finished results folder. Each point becomes one run, with its settings as hyper-parameters, its
curves averaged over runs with their standard deviation, and the means of runs.parquet. Nothing is uploaded.
"""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    parser = Parser(
        prog=f"bojax {name}",
        usage=f"bojax {name} DIR --to TARGET [--out DIR]",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument("folder", metavar="DIR", type=path, help="results folder")
    parser.add_argument(
        "--to",
        metavar="TARGET",
        required=True,
        type=one_of(TARGETS),
        help="csv, or the extras mlflow, tensorboard or wandb",
    )
    parser.add_argument(
        "--out",
        type=path,
        metavar="DIR",
        help="folder to write, new or empty (default: export/TARGET in DIR)",
    )
    args = parser.parse_intermixed_args(list(words))

    from bojax.report.exporting.build import export

    print(export(args.folder, args.to, args.out))
    return 0
