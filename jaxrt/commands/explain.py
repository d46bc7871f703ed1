"""`jaxrt explain`: which effects a scene calls for, and why."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from .options import tolerance
from .shared import load, progress_bar, span

if TYPE_CHECKING:
    from ..effects import Plan


def add(commands: Any, scene: argparse.ArgumentParser) -> None:
    parser = commands.add_parser("explain", parents=[scene], help="which effects a scene calls for, and why")
    add = parser.add_argument
    add("--measure", action="store_true", help="time a small picture with and without each effect")
    add("--rtol", metavar="R", type=tolerance, help="what a picture with this relative error will cost, as 1%%")
    for flag, what in (("without", "out"), ("with", "in")):
        text = f"force effects {what}, and measure what a small picture loses; see the table for names"
        add(
            f"--{flag}",
            metavar="NAMES",
            type=lambda text: text.split(","),
            default=[],
            dest=f"{what}_forced",
            help=text,
        )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    scene = load(args)
    from ..effects import plan
    from ..effects.table import show

    forced: dict[str, Any] = dict.fromkeys(args.in_forced, True) | dict.fromkeys(args.out_forced, False)
    fixed, free, costs = plan(scene, free=None, **forced), plan(scene, **forced), None
    if args.measure:
        from ..effects.costs import effect_costs

        with progress_bar() as progress:
            say = progress and (lambda name, share: progress(share))
            costs = effect_costs(scene, progress=say, **forced)
    show(fixed, costs)
    changes = [("in", free.effects - fixed.effects), ("out", fixed.effects - free.effects)]
    said = [f"{', '.join(sorted(names))} would be {where}" for where, names in changes if names]
    print(f"with every parameter free: {'; '.join(said) or 'the same effects'}")
    if forced:
        from ..effects.costs import dropped_radiance

        mean, lost, error = dropped_radiance(scene, forced)
        share = f", {lost / mean:.2%} of {mean:.3g}" if mean else ""
        print(f"the mean of a small picture loses {lost:.3g} ± {error:.1g}{share}; {_dropped(fixed)}")

    if args.rtol is not None:
        from ..solver.render import forecast

        told = forecast(scene, args.rtol)
        print(f"by {told.method} ({told.why})")
        if told.bounces:
            print(told.bounces)
        for one in told.costs:
            print(f"relative error {one.error:.3%}: {span(one.seconds)}")


def _dropped(plan: Plan) -> str:
    return f"left out: {', '.join(plan.dropped)}" if plan.dropped else "nothing that the scene has is left out"
