"""The picture of `against_solid.py`: shapes, section, gaps, currents, tilt, and what is worth how much."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from .arm import Arm
from .equilibrium import Bent
from .mesh import Mesh

RODS = {
    "incompressible": ("tab:green", "--"),
    "rigid, c = 1": ("tab:blue", "-"),
    "paper's constraint, c = 1": ("tab:red", "-"),
    "rigid, c = 2": ("tab:blue", ":"),
    "paper's constraint, c = 2": ("tab:red", ":"),
}
PULLED = "20 N in air"


def draw(path: Path, arm: Arm, mesh: Mesh, bent: Bent, shapes: dict[str, dict[str, Any]], rows: list[Any]) -> None:
    """`shapes`: by load and by model; `rows` of the table."""
    figure = Figure(figsize=(16.0, 8.0), layout="constrained")
    panels = figure.subplot_mosaic([["side", "side", "side", "currents"], ["section", "tilt", "gaps", "worth"]])
    side_view(panels["side"], figure, mesh, bent, shapes[PULLED])
    in_currents(panels["currents"], shapes)
    along(panels["section"], arm, shapes[PULLED], "beta", "cross-section scale beta")
    panels["section"].plot(1e3 * bent.s, bent.scale_3, color="0.6", linewidth=1, label="solid, across the plane")
    panels["section"].legend(frameon=False, fontsize=7)
    along(panels["tilt"], arm, shapes[PULLED], "tilt", "tilt alpha - theta [deg]", np.degrees)
    tip_gaps(panels["gaps"], arm, rows)
    what_counts(panels["worth"], rows)
    figure.savefig(path, dpi=110)


def side_view(axes: Axes, figure: Figure, mesh: Mesh, bent: Bent, shapes: dict[str, Any]) -> None:
    """The bricks at the plane of symmetry, colored by the pressure at their centers, and the rods' centerlines."""
    bricks, edge = mesh.bricks.reshape(-1, 3, 3, 3), mesh.nodes[:, 2] < 1e-12
    outlines, colors = [], []
    for face in (np.s_[:, :, :, 0], np.s_[:, :, :, 2], np.s_[:, :, 0, :], np.s_[:, :, 2, :]):
        nodes = bricks[face]
        flat = edge[nodes].all((1, 2))
        ring = nodes[flat][:, [0, 0, 0, 1, 2, 2, 2, 1], [0, 1, 2, 2, 2, 1, 0, 0]]
        outlines += list(1e3 * bent.x[ring, :2])
        colors += list(1e-6 * bent.p[flat, 0])
    drawn = PolyCollection(outlines, array=np.array(colors), cmap="coolwarm", edgecolors="k", linewidths=0.3)
    drawn.set_clim(-np.abs(colors).max(), np.abs(colors).max())
    axes.add_collection(drawn)
    figure.colorbar(drawn, ax=axes, label="p of the solid [MPa]", shrink=0.8)
    for name, (color, style) in RODS.items():
        axes.plot(1e3 * shapes[name].x, 1e3 * shapes[name].y, color=color, linestyle=style, label=name)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", title=f"{PULLED}: solid and centerlines of rods", aspect="equal")
    axes.legend(frameon=False, fontsize=8)


def along(axes: Axes, arm: Arm, shapes: dict[str, Any], field: str, label: str, scale: Any = np.asarray) -> None:
    """One field over s."""
    solid = shapes["solid"]
    axes.plot(1e3 * solid.s, scale(getattr(solid, field)), "k", linewidth=2.5, label="solid")
    for name, (color, style) in RODS.items():
        axes.plot(1e3 * shapes[name].s, scale(getattr(shapes[name], field)), color=color, linestyle=style, label=name)
    axes.set(xlabel="s [mm]", ylabel=label, title=PULLED, xlim=(0, 1e3 * arm.length))


def tip_gaps(axes: Axes, arm: Arm, rows: list[Any]) -> None:
    """Distance of the tips from the solid's over tension."""
    for name, (color, style) in RODS.items():
        of_rod = [row for row in rows if row.model == name and row.load.endswith("in air")]
        tensions = [float(row.load.split()[0]) for row in of_rod]
        values = [row.tip_from_solid_m / arm.length for row in of_rod]
        axes.semilogy(tensions, values, color=color, linestyle=style, marker="o", markersize=4, label=name)
    axes.set(xlabel="tension [N]", ylabel="tip from the solid's / length", title="tips of rods in air")


def in_currents(axes: Axes, shapes: dict[str, dict[str, Any]]) -> None:
    """Centerlines at 20 N under water."""
    styles = {
        "solid": ("k", "-", 2.5),
        "incompressible": ("tab:green", "--", 1.5),
        "paper's constraint, c = 1": ("tab:red", "-", 1),
        "solid, one-way, straight": ("tab:orange", "-.", 1.5),
        "solid, one-way, bent in still water": ("tab:purple", "-.", 1.5),
    }
    speeds = [name for name in shapes if name.endswith("m/s")]
    for speed in speeds:
        for name, (color, style, width) in styles.items():
            shape, label = shapes[speed][name], name if speed == speeds[0] else None
            axes.plot(1e3 * shape.x, 1e3 * shape.y, color=color, linestyle=style, linewidth=width, label=label)
        tip = shapes[speed]["solid"]
        axes.annotate(speed.split(" at ")[1], (1e3 * tip.x[-1] + 8, 1e3 * tip.y[-1]), fontsize=8)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", title="20 N in both currents", xlim=(250, 420), ylim=(-25, 135))
    axes.legend(frameon=False, fontsize=7, loc="lower right")


def what_counts(axes: Axes, rows: list[Any]) -> None:
    """How far each assumption moves the tip at 20 N in air."""
    moved = {row.model: 1e3 * row.tip_from_solid_m for row in rows if row.load == PULLED and row.model != "solid"}
    names = sorted(moved, key=moved.__getitem__)
    colors = [RODS[name][0] if name in RODS else "0.6" for name in names]
    axes.barh(names, [moved[name] for name in names], color=colors)
    axes.set(xscale="log", xlabel="tip from the solid's [mm]", title=f"{PULLED}: what moves the tip")
    axes.tick_params(axis="y", labelsize=7)
