"""Reads a table of numbers from a CSV file, whatever separates its cells."""

import csv
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, quoted


def read_csv(path: Path) -> dict[str, Any]:
    """The columns of a table that commas separate, or semicolons or tabs, beside which decimal commas are read."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give a CSV file") from None
    except (OSError, ValueError) as error:  # ValueError: not UTF-8, or a name with a zero byte
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise InputError(f"{path}: cannot be read: {reason}") from None
    lines = ["" if line.startswith("#") else line for line in text.splitlines(keepends=True)]
    first = next((line for line in lines if line.strip()), "")
    delimiter = next((mark for mark in ";\t" if mark in first), ",")
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    try:
        found = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: {error}") from None
    if len(found) < 2:
        raise InputError(f"{path}: {'empty' if not found else 'no rows'}; give a line of heads and rows of numbers")
    heads = [head.strip() for head in found[0][1]]
    if len(set(heads)) < len(heads):
        twice = next(head for head in heads if heads.count(head) > 1)
        raise InputError(f"{path}: every column must have a head of its own, but {quoted(twice)} is there twice")
    table = []
    for number, row in found[1:]:
        if len(row) != len(heads):
            raise InputError(
                f"{path}: line {number} must have {len(heads)} cells, one for each head, but has {len(row)}"
            )
        where = [f"{path}: line {number}, {head}" for head in heads]
        table.append([_cell(cell, at, delimiter != ",") for cell, at in zip(row, where, strict=True)])
    return dict(zip(heads, np.array(table, dtype=float).T, strict=True))


def _cell(text: str, where: str, decimal_commas: bool) -> float:
    written = text.strip().replace(",", ".") if decimal_commas and text.count(",") == 1 else text.strip()
    try:
        number = float(written) if written else np.nan
    except ValueError:
        raise InputError(f"{where} must be a number, but is {quoted(text.strip())}") from None
    if np.isinf(number):
        raise InputError(
            f"{where} must be a finite number, or blank where nothing was measured, but is {quoted(text.strip())}"
        )
    return number
