"""The training loop: phases as data, checkpoints that go on to the bit.

Every draw of a step (its samples, the noise of the latents) is a function of seed, phase and step alone, so a training
that was killed goes on as if it had not been. A checkpoint is written between a step's loss and its update: its weights
are known to give a sound loss.
"""

from __future__ import annotations

import hashlib
import json
import math
import multiprocessing
import os
import time
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path

import torch
from pydantic import TypeAdapter, ValidationError
from torch.utils.data import DataLoader, Sampler, default_collate

from ...errors import UserError
from ...io.camera import first_error
from ...io.files import write_text
from ...kernels import InputError
from ..model.checkpoint import Checkpoints, load_model, load_optimiser
from .data import AvatarData
from .losses import total
from .objective import Objective

MEASURED = 4  # steps of each phase that --minutes times, after a first one that warms up
SOUND = 8  # losses of a phase before one of them can be beyond their mean
WORKERS = 8  # processes that read samples for an accelerator, at most; a CPU reads them itself


class Diverged(UserError):
    """A loss or gradient that is not finite, or a loss beyond a multiple of its recent mean."""


@dataclass
class Position:
    """Where a training stands, as its checkpoints keep it."""

    steps: list[int]  # of each phase
    phase: int = 0
    step: int = 0  # within the phase
    total: int = 0  # of all phases
    returns: int = 0  # to a checkpoint after a divergence
    recent: list[float] = field(default_factory=list)  # last losses of this phase
    spent: float = 0.0  # [s]
    costs: list[float] = field(default_factory=list)  # of a step of each phase [s], where a time was given


def position_of(facts, phases, path):
    """Where a checkpoint's facts say that a training of these phases stood. UserError: no training of these stands there."""
    try:
        at = TypeAdapter(Position).validate_python(facts)
    except ValidationError as error:
        raise first_error(path, error) from None
    if len(at.steps) != len(phases) or not 0 <= at.phase < len(phases) or not 0 <= at.step <= at.steps[at.phase]:
        raise UserError(
            f"{path}: steps {at.steps}, phase {at.phase}, step {at.step}: no training of this avatar stands there"
        )
    return at


class Training:
    """One avatar's training in one folder, in `seconds` from `begun` on where they are given.

    `progress(stage, done, total, note)` and `say(message)` tell how it goes.
    """

    def __init__(self, folder, avatar, data, settings, phases, fabric, progress, say, begun=None, seconds=None):
        self.folder, self.data, self.settings, self.fabric = Path(folder), data, settings, fabric
        self.progress, self.say, self.seconds = progress, say, seconds
        kinds = {layer.kind for layer in data.layers}
        self.phases = [phase for phase in phases if phase.steps and kinds & set(phase.kinds)]
        self.objective = Objective(avatar, settings, half=fabric.device.type != "cpu")
        self.module = fabric.setup_module(self.objective)
        self.checkpoints = Checkpoints(self.folder / "checkpoints")
        self.at = Position([phase.steps for phase in self.phases])
        self.log = TrainingLog(self.folder) if fabric.is_global_zero else None
        self.begun = begun or time.monotonic()

    def run(self):
        """Trains from where the folder's last checkpoint stands to the end. Returns {phase: steps}."""
        tensors = self._restore()
        if tensors is None:
            self.objective.prepare(self.data, self.fabric.to_device)
            if self.log:
                self.log.cut(0)
        if self.seconds is not None and not self.at.costs:
            if tensors is not None:
                self.say(f"{self.folder}: begun without --minutes, which decide from here on how many steps are left")
            self.at.costs = [self._time_a_step(phase) for phase in self.phases]
            self._plan()
        while self.at.phase < len(self.phases):
            try:
                self._train_phase(tensors if self.at.step else None)
                self.at.phase, self.at.step, self.at.recent = self.at.phase + 1, 0, []
            except Diverged as error:
                tensors = self._go_back(error)
        self._picture()
        if self.log:
            self.log.close()
        return {phase.name: steps for phase, steps in zip(self.phases, self.at.steps)}

    def _train_phase(self, tensors):
        """The steps left of the phase at hand; `tensors` of a checkpoint hold its optimiser's moments."""
        phase, at, settings = self.phases[self.at.phase], self.at, self.settings
        optimiser = self._optimiser(phase, tensors)
        batches, planned = iter(self._loader(phase, at.step)), (at.step, time.monotonic())
        while at.step < at.steps[at.phase]:
            terms, loss = self._loss(phase, at.step, at.steps[at.phase], next(batches))
            value = float(self.fabric.all_reduce(loss.detach(), reduce_op="mean"))
            self._check(phase, value)
            if at.step % settings.checkpoint_every == 0:
                if self.seconds is not None and at.step > planned[0]:
                    planned = self._plan_again(*planned)
                self._checkpoint(optimiser)
            rate = self._update(phase, optimiser, loss)
            at.recent = [*at.recent, value][-settings.divergence_steps :]
            self._note(phase, value, terms, rate)
            at.step, at.total = at.step + 1, at.total + 1

    def _loss(self, phase, step, steps, batch):
        """({term: value}, their weighted sum) of a step's samples."""
        torch.manual_seed(draw(self.settings.seed, self.at.returns, phase.name, step, self.fabric.global_rank))
        try:
            terms = self.module(batch, phase, step / max(steps - 1, 1))
        except InputError:  # the renderer and the core refuse vertices that are not finite
            return {}, torch.tensor(math.nan, device=self.fabric.device)
        return terms, total(terms, self.settings.weights)

    def _check(self, phase, loss):
        recent = self.at.recent
        where = f"{phase.name}, step {self.at.step}"
        if not math.isfinite(loss):
            raise Diverged(f"{where}: the loss is not finite")
        if len(recent) >= SOUND and loss > self.settings.divergence_ratio * sum(recent) / len(recent):
            raise Diverged(
                f"{where}: the loss {loss:.3g} is beyond {self.settings.divergence_ratio:g} x its recent mean"
            )

    def _update(self, phase, optimiser, loss):
        """One step of AdamW; returns its learning rate."""
        at = self.at
        share = rate_at(at.step, at.steps[at.phase], self.settings) * 0.5**at.returns
        for group in optimiser.param_groups:
            group["lr"] = group["base"] * share
        optimiser.zero_grad(set_to_none=True)  # what a phase does not train keeps no gradient and stays as it is
        self.fabric.backward(loss)
        norm = self.fabric.clip_gradients(
            self.module, optimiser, max_norm=self.settings.gradient_limit, error_if_nonfinite=False
        )
        if not math.isfinite(float(norm)):
            raise Diverged(f"{phase.name}, step {at.step}: the gradient is not finite")
        optimiser.step()
        return phase.lr * share

    def _optimiser(self, phase, tensors):
        named = list(self.objective.named_parameters())
        colour = [p for name, p in named if "colour" in name]
        others = [p for name, p in named if "colour" not in name]
        groups = [{"params": others, "base": phase.lr}, {"params": colour, "base": self.settings.colour_lr}]
        optimiser = torch.optim.AdamW([group for group in groups if group["params"]], lr=phase.lr, fused=True)
        if tensors is not None:
            load_optimiser(optimiser, tensors, self.checkpoints.newest())
        return self.fabric.setup_optimizers(optimiser)

    def _loader(self, phase, start):
        order = BatchOrder(len(self.data), phase, (self.settings.seed, self.at.returns), start, self.fabric)
        workers = 0 if self.fabric.device.type == "cpu" else min(WORKERS, os.cpu_count() or 1)
        loader = DataLoader(
            self.data, batch_sampler=order, num_workers=workers, pin_memory=workers > 0,
            multiprocessing_context=reading() if workers else None,
        )  # fmt: skip
        return self.fabric.setup_dataloaders(loader, use_distributed_sampler=False)

    def _checkpoint(self, optimiser):
        self.at.spent = self._spent()
        if self.fabric.is_global_zero:
            self.checkpoints.write(self.at.total, self.objective, optimiser, asdict(self.at))
        self.fabric.barrier()

    def _restore(self):
        """Back to the last checkpoint: its tensors, None where there is none."""
        found = self.checkpoints.latest()
        if found is None:
            return None
        tensors, facts = found
        load_model(self.objective, tensors, self.checkpoints.newest())
        self.at = position_of(facts, self.phases, self.checkpoints.newest())
        self.begun = time.monotonic() - self.at.spent
        if self.log:
            self.log.cut(self.at.total)
        return tensors

    def _go_back(self, error):
        """After a divergence: the last good checkpoint, another draw of samples, half the learning rate."""
        returns, spent = self.at.returns + 1, self._spent()
        if returns > self.settings.max_returns:
            raise UserError(
                f"{error}, after {self.settings.max_returns} returns to a good checkpoint: give a smaller --lr"
            )
        tensors = self._restore()
        if tensors is None:
            raise UserError(f"{error} before anything was learnt: look at the run's geometry and pictures")
        self.at.returns, self.begun = returns, time.monotonic() - spent
        where = f"{self.phases[self.at.phase].name}, step {self.at.step}"
        self.say(f"{error}: back to the checkpoint at {where}, learning rate x {0.5**returns:g}")
        return tensors

    def _spent(self):
        return time.monotonic() - self.begun

    def _time_a_step(self, phase):
        """Seconds that a step of a phase takes, measured on a few that leave no trace."""
        before = {name: value.clone() for name, value in self.objective.state_dict().items()}
        optimiser, times = self._optimiser(phase, None), []
        for step, batch in zip(range(MEASURED + 1), self._loader(phase, 0)):
            times.append(time.monotonic())
            _, loss = self._loss(phase, step, MEASURED, batch)
            self._update(phase, optimiser, loss)
        times.append(time.monotonic())
        self.objective.load_state_dict(before)
        return sorted(b - a for a, b in zip(times[1:], times[2:]))[MEASURED // 2]

    def _plan_again(self, step, since):
        """As the machine is now: since `step` at a time, all steps have cost so many times what they were thought to."""
        at, now = self.at, time.monotonic()
        slower = (now - since) / (at.step - step) / at.costs[at.phase]
        at.costs = [cost * slower for cost in at.costs]
        self._plan()
        return at.step, now

    def _plan(self):
        """Steps of what is left, so that it fits the time: in the phases' proportions, at their measured costs."""
        at = self.at
        done = [float(i < at.phase) for i in range(len(self.phases))]
        done[at.phase] = at.step / at.steps[at.phase]
        left = [phase.steps * (1 - share) for phase, share in zip(self.phases, done)]
        scale = max(self.seconds - self._spent(), 0) / sum(n * cost for n, cost in zip(left, at.costs))
        scale = self.fabric.broadcast(scale)
        for i in range(at.phase, len(self.phases)):
            at.steps[i] = (at.step if i == at.phase else 0) + max(round(left[i] * scale), 1)

    def _note(self, phase, loss, terms, rate):
        at = self.at
        self.progress(phase.name, at.step + 1, at.steps[at.phase], f"loss {sum(at.recent) / len(at.recent):.4f}")
        if self.log:
            self.log.add(at.total, phase.name, at.step, loss, {n: float(v.detach()) for n, v in terms.items()}, rate)
        if at.total % self.settings.picture_every == 0:
            self._picture()

    def _picture(self):
        if self.log:
            batch = self.fabric.to_device(default_collate([self.data[0]]))
            self.log.picture(self.at.total, self.objective.picture(batch))


@cache
def reading():
    """How processes that read samples are started: as copies of one that has imported what they need. Started anew each would take
    seconds, and copies of this process could stand still in locks that its threads hold."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([AvatarData.__module__])
    return context


class BatchOrder(Sampler):
    """Batches of sample numbers from step `start` on, without end: epoch after epoch, each in an order of its own."""

    def __init__(self, count, phase, seeds, start, fabric):
        self.count, self.phase, self.seeds, self.start = count, phase, seeds, start
        self.rank, self.world = fabric.global_rank, fabric.world_size

    def __iter__(self):
        batch, epoch, order = self.phase.batch, -1, None
        first = (self.start * self.world + self.rank) * batch
        while True:
            numbers = []
            for place in range(first, first + batch):
                if place // self.count != epoch:
                    epoch = place // self.count
                    generator = torch.Generator().manual_seed(draw(*self.seeds, self.phase.name, "epoch", epoch))
                    order = torch.randperm(self.count, generator=generator).tolist()
                numbers.append(order[place % self.count])
            yield numbers
            first += self.world * batch


class TrainingLog:
    """FOLDER/losses.jsonl, a line a step, and TensorBoard's files with pictures in FOLDER/logs."""

    def __init__(self, folder):
        self.path, self.folder = Path(folder) / "losses.jsonl", Path(folder) / "logs"
        self.file = self.writer = None

    def cut(self, total):
        """Forgets what lies at or beyond a step that will be taken again."""
        self.close()
        if self.path.exists():
            lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True)
            write_text(self.path, "".join(lines[:total]))
        self._open(total)

    def add(self, total, phase, step, loss, terms, rate):
        if self.writer is None:
            self._open(total)
        self.file.write(json.dumps({"phase": phase, "step": step, "loss": loss, **terms, "rate": rate}) + "\n")
        self.file.flush()
        for name, value in {"loss": loss, **terms, "rate": rate}.items():
            self.writer.add_scalar(f"{phase}/{name}", value, total)

    def picture(self, total, image):
        """(3,H,W) 0..1."""
        if self.writer is None:
            self._open(total)
        self.writer.add_image("captured, rendered", image, total)

    def close(self):
        if self.writer is not None:
            self.file.close()
            self.writer.close()
        self.file = self.writer = None

    def _open(self, total):
        from torch.utils.tensorboard import SummaryWriter

        self.folder.mkdir(parents=True, exist_ok=True)
        self.file = open(self.path, "a", encoding="utf-8")
        self.writer = SummaryWriter(str(self.folder), purge_step=total)


def draw(*parts):
    """A seed from what a draw is for."""
    return int.from_bytes(hashlib.sha256(repr(parts).encode()).digest()[:8], "little") >> 1


def rate_at(step, steps, settings):
    """Share of the learning rate at a step: rises over the first steps, falls by half a cosine to `final_rate`."""
    rise = min((step + 1) / max(settings.warm_up_share * steps, 1), 1.0)
    fall = 0.5 * (1 + math.cos(math.pi * min(step / max(steps, 1), 1.0)))
    return rise * (settings.final_rate + (1 - settings.final_rate) * fall)
