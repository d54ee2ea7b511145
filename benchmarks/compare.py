"""Compare whole cycles of this controller, tsid, placo, a lower bound, and older commits, on the same states.

    python benchmarks/compare.py                        all: `make bench`
    python benchmarks/compare.py --against d8d35bb      with our code of that commit: `make bench AGAINST=d8d35bb`
    python benchmarks/compare.py --cases talos-double g1-service --rivals tsid

Method and differences of the controllers: docs/benchmarks.md.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import contestants
import numpy as np
import scenes
from contestants import Answers, Contestant
from our_cycle import Cycle
from timing import share, summary

from wbc_controller.errors import valid_choices
from wbc_controller.records import Array, Reference, References

#: Cycles of a warm and of a cold block, and number of blocks.
WARM, COLD, BLOCKS = 1000, 50, 20
#: Untimed cycles at the beginning of a warm block, until the caches are filled.
FILLING = 100
#: Bytes written before a cold cycle: twice the last-level cache of a usual processor.
EVICTION_BYTES = 64 * 2**20
#: One in so many warm states is used in the comparison of the answers.
COMPARED_STRIDE = 25

FOOT = """\
Times in µs; columns warm and cold: medians. Share: our median over theirs; in brackets, range of adjacent blocks.
warm: consecutive states. cold: before each state, {megabytes:.0f} MB of other memory are written and a text is parsed.
floor: all dynamics terms and one Cholesky factorization of the size of accelerations and forces.
Only ours checks all constraints of its answer and limits the torque rate in its supervisor.
Limits of joint motion are off. placo has no limit of the normal force and of the moment about the normal; tsid and
ours have both. Friction, torque limits, gains, weights and contacts are the same.
Answers: the tasks determine v̇ and the sum of the wrenches. The distribution over several feet is free and determines
the torques. ours regularizes the moments at a sole as forces at its corners, which tsid uses; placo minimizes the
wrenches, with equal weights of N and N·m."""

Turns = dict[str, list[Answers]]
#: Our median over that of each contestant, warm and cold.
Shares = dict[str, tuple[float, float]]


def take_turns(
    parties: Sequence[Contestant], rows: Array, blocks: int, warm: int, cold: int, touched: int
) -> tuple[Turns, Turns]:
    """Let the contestants answer in turn, block by block (A B C A B C), first warm, then cold.

    Args:
        rows: states, (blocks (warm + cold), width).
        warm: number of warm states of a block; the first `FILLING` are not in the answers.
        cold: number of cold states of a block.
        touched: bytes written before a cold state.
    """
    found: tuple[Turns, Turns] = ({each.name: [] for each in parties}, {each.name: [] for each in parties})
    for i in range(blocks):
        start = i * (warm + cold)
        for each in parties:
            answers = each.solve(rows[start : start + warm])
            found[0][each.name].append(Answers(*(part[FILLING:] for part in vars(answers).values())))
        for each in parties:
            found[1][each.name].append(each.solve(rows[start + warm : start + warm + cold], touched))
    return found


def print_times(title: str, parties: Sequence[Contestant], warm: Turns, cold: Turns) -> Shares:
    """Print the table of one case."""
    shares: Shares = {}
    both = (("warm", warm), ("cold", cold))
    print(f"\n{title}")
    print(f"{'':13}" + "".join(f"{name:>8}{'p99':>8}{'p99.9':>8}   share{'':15}" for name, _ in both).rstrip())
    for each in parties:
        cells, medians = [], []
        for _, turns in both:
            ours, theirs = ([answers.seconds for answers in turns[name]] for name in ("ours", each.name))
            ratio, low, high = share(ours, theirs)
            medians.append(ratio)
            against = f"   {ratio:.2f} ({low:.2f} to {high:.2f})" if each.name != "ours" else ""
            cells.append(f"{summary(theirs)}{against:23}")
        print(f"{each.name:13}{''.join(cells)}".rstrip())
        shares[each.name] = (medians[0], medians[1])
        failures = sum(summary([answers.seconds for answers in turns[each.name]]).failures for _, turns in both)
        if failures:
            print(f"{'':13}{failures} cycles without a solution, excluded from the times")
    for each in parties:
        hello = each.hello
        if hello["unknowns"]:
            sizes = f"{hello['unknowns']} unknowns, {hello['equalities']} equalities, {hello['inequalities']} rows"
            print(f"  {' '.join((each.name, hello['version'])).strip()}: {sizes}")
        for name, turns in both:
            blocks = turns[each.name]
            parts = np.nanmedian(np.concatenate([answers.parts for answers in blocks]), axis=0)
            stages = ", ".join(
                f"{part} {1e6 * seconds:.0f}" for part, seconds in zip(hello["parts"], parts, strict=True)
            )
            mean = 1e6 * summary([answers.seconds for answers in blocks]).mean
            print(f"  {each.name}, {name}: {stages}; mean of the whole {mean:.0f}")
    return shares


def print_shares(found: dict[str, Shares]) -> None:
    """Print the shares of all cases, warm/cold."""
    names = [name for name in dict.fromkeys(name for shares in found.values() for name in shares) if name != "ours"]
    print(f"\n{'our share, warm/cold':22}" + "".join(f"{name:>14}" for name in names))
    for case, shares in found.items():
        cells = ["{:.2f}/{:.2f}".format(*shares[name]) if name in shares else "" for name in names]
        print(f"{case:22}" + "".join(f"{cell:>14}" for cell in cells).rstrip())


def print_answers(scene: scenes.Scene, parties: Sequence[Contestant], rows: list[Array], warm: Turns) -> None:
    """Print the largest differences of each contestant's answers from ours."""
    view = Cycle(scene.settings, scene.model)
    rest = view.start(scene.q)
    nq, nv = scene.model.nq, scene.model.nv
    contacts = list(view.controller.contacts.values())
    places = np.cumsum([contact.size for contact in contacts])[:-1]
    to_command = scene.model.v_index - 6
    for each in parties:
        if each.name == "ours" or not each.hello["sizes"][0]:
            continue
        worst = dict.fromkeys(("v̇", "sum of the wrenches", "each force", "τ", "cost"), 0.0)
        for block, states in enumerate(rows):
            for i in range(0, len(states), COMPARED_STRIDE):
                ours, theirs = warm["ours"][block], warm[each.name][block]
                if not (np.isfinite(ours.seconds[i]) and np.isfinite(theirs.seconds[i])):
                    continue
                q, v, reference = np.split(states[i], [nq, nq + nv])
                dynamics = view.controller.dynamics
                dynamics.update(q, v)
                sums, costs = [], []
                for answers in (ours, theirs):
                    forces = np.split(answers.forces[i], places)
                    sums.append(sum(c.wrench_in_world(dynamics, f) for c, f in zip(contacts, forces, strict=True)))
                    costs.append(_cost(view, rest, reference, answers.v_dot[i]))
                # Rivals use the order of the model, ours the order of the command.
                tau = theirs.tau[i] if each.name not in contestants.RIVALS else theirs.tau[i][to_command]
                found = {
                    "v̇": np.abs(ours.v_dot[i] - theirs.v_dot[i]).max(),
                    "sum of the wrenches": np.abs(sums[0] - sums[1]).max(),
                    "each force": np.abs(ours.forces[i] - theirs.forces[i]).max(initial=0.0),
                    "τ": np.abs(ours.tau[i] - tau).max(),
                    "cost": abs(costs[0] - costs[1]) / max(*costs, 1.0),
                }
                worst = {key: max(value, float(found[key])) for key, value in worst.items()}
        differences = ", ".join(f"{key} {value:.1e}" for key, value in worst.items())
        print(f"  largest differences of {each.name} from ours: {differences}")


def _cost(view: Cycle, rest: References, reference: Array, v_dot: Array) -> float:
    """Return Σ w ‖J v̇ - b‖² of the tasks in the state of the view's dynamics."""
    com = Reference(*np.split(reference, 3))
    total = 0.0
    for name, task in view.controller.tasks.items():
        J, right, _ = task.equation(view.controller.dynamics, com if name == "com" else rest.tasks[name])
        total += rest.weights[name] * float(np.sum((J @ v_dot - right) ** 2))
    return total


def compare(
    case: scenes.Case, rivals: Sequence[str], older: tuple[str, Path] | None, blocks: int, folder: Path
) -> Shares:
    """Measure and print one case of frozen states."""
    scene = scenes.make(case, blocks * (WARM + COLD), folder)
    content = scene.message()
    with ExitStack() as stack:
        parties = [stack.enter_context(contestants.floor(content)), stack.enter_context(contestants.ours(content))]
        if older:
            parties.append(stack.enter_context(contestants.ours(content, *older)))
        parties += [stack.enter_context(contestants.rival(name, content)) for name in rivals]
        warm, cold = take_turns(parties, scene.rows, blocks, WARM, COLD, EVICTION_BYTES)
    shares = print_times(f"{case.title} ({case.name})", parties, warm, cold)
    states = [scene.rows[i * (WARM + COLD) + FILLING : i * (WARM + COLD) + WARM] for i in range(blocks)]
    print_answers(scene, parties, states, warm)
    return shares


def compare_services(robot: str, older: tuple[str, Path] | None, blocks: int) -> Shares:
    """Measure and print the whole cycle of a supplied robot, from input to output messages."""
    content, rows = scenes.make_service(robot, blocks * (WARM + COLD))
    with ExitStack() as stack:
        parties = [stack.enter_context(contestants.service(content))]
        if older:
            parties.append(stack.enter_context(contestants.service(content, *older)))
        warm, cold = take_turns(parties, rows, blocks, WARM, COLD, EVICTION_BYTES)
    shares = print_times(f"{robot} as supplied, messages to messages ({robot}-service)", parties, warm, cold)
    for each in parties[1:]:
        pairs = zip(warm["ours"] + cold["ours"], warm[each.name] + cold[each.name], strict=True)
        worst = max(float(np.abs(ours.tau - theirs.tau).max()) for ours, theirs in pairs)
        print(f"  largest difference of {each.name} from ours: τ {worst:.1e}")
    return shares


def main(arguments: Sequence[str]) -> None:
    """Print all tables.

    Raises:
        SystemExit: if an argument is invalid, or a rival cannot be installed.
    """
    services = [f"{robot}-service" for robot in scenes.SERVICES]
    known = [*scenes.CASES, *services]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", metavar="COMMIT", help="include our code of this commit")
    parser.add_argument("--cases", nargs="+", default=known, metavar="CASE", help=f"of {', '.join(known)}")
    parser.add_argument("--rivals", nargs="+", default=list(contestants.RIVALS), help="tsid, placo or none")
    parser.add_argument(
        "--blocks", type=int, default=BLOCKS, help=f"number of blocks of {WARM} warm and {COLD} cold states"
    )
    chosen = parser.parse_args(arguments)
    rivals = [] if chosen.rivals == ["none"] else chosen.rivals
    for key, names, valid in (("--cases", chosen.cases, known), ("--rivals", rivals, contestants.RIVALS)):
        for name in names:
            if name not in valid:
                raise SystemExit(f"{key}: unknown name {name!r}; {valid_choices(name, valid)}")
    if not chosen.blocks >= 1:
        raise SystemExit(f"--blocks {chosen.blocks}; valid: at least 1")
    with ExitStack() as stack:
        older = None
        if chosen.against:
            older = f"at {chosen.against}"[:12], stack.enter_context(contestants.code_of(chosen.against))
        if any(name in scenes.CASES for name in chosen.cases):
            for name in rivals:
                contestants.environment(name)
        folder = Path(stack.enter_context(TemporaryDirectory()))
        if hasattr(os, "sched_setaffinity"):
            allowed = os.sched_getaffinity(0)
            stack.callback(os.sched_setaffinity, 0, allowed)
            os.sched_setaffinity(0, {max(allowed)})  # inherited by the contestants
        found = {}
        for name in chosen.cases:
            if name in scenes.CASES:
                found[name] = compare(scenes.CASES[name], rivals, older, chosen.blocks, folder)
            else:
                found[name] = compare_services(name.removesuffix("-service"), older, chosen.blocks)
            sys.stdout.flush()
        print_shares(found)
    print("\n" + FOOT.format(megabytes=EVICTION_BYTES / 2**20))


if __name__ == "__main__":
    main(sys.argv[1:])
