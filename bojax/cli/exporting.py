"""`bojax export`: finished results as CSV files or as runs of TensorBoard, Weights & Biases or MLflow."""

from collections.abc import Sequence

from bojax.cli.parser import Parser, one_of, path

TARGETS = ("csv", "mlflow", "tensorboard", "wandb")
"""What results can be exported to; `bojax.report.exporting` has a function for each."""

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
    parser = Parser(name, "DIR --to TARGET [--out DIR]", _DESCRIPTION, _EXAMPLES)
    parser.option("folder", "DIR", "results folder", path)
    targets = "csv, or the extras mlflow, tensorboard or wandb"
    parser.option("--to", "TARGET", targets, one_of(TARGETS), required=True)
    parser.option("--out", "DIR", "folder to write, new or empty (default: export/TARGET in DIR)", path)
    args = parser.read(words)

    from bojax.report.exporting import export

    print(export(args.folder, args.to, args.out))
    return 0
