"""What the reasons of verdicts and failures come down to, and what to do about each."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

AGAIN = "give them again, which looks for the pose without the neighbours'"


@dataclass(frozen=True)
class Trouble:
    """A kind of trouble: reasons that `pattern` is found in, a title, and what to do."""

    title: str
    pattern: str
    do: str


TROUBLES = (
    Trouble("the scan is coarse", r"the scan's triangles are",
            "Nothing finer than its triangles can be registered: was it thinned too far, or is it in other units?"),
    Trouble("scan and surface lie apart", r"scan and surface lie .* apart",
            f"Is the scan whole, and nothing but the person? If it is, {AGAIN}."),
    Trouble("a limb lies elsewhere", r"of the surface is not where the scan is",
            f"A limb was bent to another part of the scan. Look at the first frame where it is; {AGAIN}, or add keypoints."),
    Trouble("the pose misses part of the scan", r"is not where the posed body is",
            f"A limb or all of the skeleton stands elsewhere: {AGAIN}, or add keypoints."),
    Trouble("the pose stands beside the scan", r"the posed body lies",
            f"The skeleton is off and its surface was bent to the scan: {AGAIN}, or add keypoints."),
    Trouble("the person is hardly a person's size", r"the person's stature lies",
            "Are scans and cameras in the units that scene.toml says? If she is of this size, give verdict.stature_off_m more room."),
    Trouble("the surface was bent far", r"the posed body was bent",
            f"The skeleton missed something, often a limb: {AGAIN}, or add keypoints."),
    Trouble("keypoints disagree", r"keypoints are more than",
            "Look for left and right exchanged, and at the cameras: toile inspect CAPTURE says whether one has moved."),
    Trouble("the face is elsewhere", r"of the facial keypoints lie off the face",
            "The detector took another face, or a hand, for it in these frames: the face is told by the surface alone."),
    Trouble("silhouettes disagree", r"silhouette and masks overlap",
            "Look at the masks of these frames: parts missing, or another person in them. Else the pose is off."),
    Trouble("cloth sticks out into the air", r"cloth reaches .* beyond the masks",
            "An end of the garment was thrown off the person: look at the labels around it, and at the frame where it begins."),
    Trouble("something sticks out into the air", r"the silhouette reaches .* beyond the masks",
            f"A limb or cloth lies where the pictures show none. Is a mask short of it? Else {AGAIN}."),
    Trouble("something is not covered", r"reach .* beyond the silhouette",
            "The masks show what no surface explains: another thing in them, hair, a limb that is lost, a fold that was missed."),
    Trouble("label images show more", r"of what the label images show lies beyond",
            "The pictures show the person elsewhere than the scan, or label what no surface explains: toile inspect CAPTURE compares both."),
    Trouble("little of the body is seen", r"of the surface was found on the scan",
            "The scan has holes and no picture shows the rest: are cameras missing in these frames?"),
    Trouble("a limb is not seen", r"of an arm, a leg or the head (is shown|was found)",
            "The scan lacks it and no picture shows it: its place is a guess. Add keypoints, or leave it out of what you use."),
    Trouble("a limb lies in the body", r"of an arm or a leg lies within the body",
            "The scan lacks it, and it was laid where there is scan: add keypoints, or leave it out of what you use."),
    Trouble("little of the garment is seen", r"of the garment was found on the labelled scan",
            "Look at the label images: is the garment marked in several views of these frames?"),
    Trouble("the garment lies off its scan", r"garment and labelled scan lie",
            "Look at the labels, which may bleed onto skin or other cloth, and at the template's size."),
    Trouble("openings are not seen", r"of the openings that (other frames show|are not hidden throughout)",
            "Their place is guessed from what is seen beside it: has the scan holes there, or do labels hide them in these frames?"),
    Trouble("an opening is guessed", r"of an opening that no frame shows lies where there is no scan",
            "Neither scan nor labels show where the garment ends there: leave that end out of what you use, or add a camera on that side."),
    Trouble("an opening lies elsewhere", r"an opening lies",
            "Look at the labels around that opening. In all frames at once: the template's loops or its size are wrong."),
    Trouble("an opening has another length", r"the sampled frames show the opening",
            "The sleeve or hem was caught, tucked or taken for another: look at the labels around it."),
    Trouble("an opening is cut off", r"of the opening's length that the cloth",
            "The scan closes the opening, by a web or a fold that it lacks: compare it with the pictures; labels may mend it."),
    Trouble("an opening is joined to other cloth", r"mm longer than the cloth",
            "It runs over cloth beside it, as a sleeve's that a web of the scan joins to the trunk. A template of its true length, finer pictures or `standard` may tell it."),
    Trouble("a sleeve is joined to the trunk", r"of the opening lies at the trunk",
            "A web of the scan joins them, or an arm lies against the body: look at the scan between them. Arms held off the trunk in some frames of the preparation, or `standard`, may part them."),
    Trouble("openings that belong to none", r"of seen openings belong to no loop",
            "The labels have holes or islands, or the garment is folded, tucked in or open where the template is not."),
    Trouble("edges of the garment are strained", r"of the garment's edges are as long as",
            "In all frames: the template has another size. In some: the garment was caught on something, look at the labels."),
    Trouble("the garment is stretched", r"of the garment is stretched",
            "In all frames: the template is too small. In some: a label elsewhere pulls it there."),
    Trouble("the garment is turned over", r"of the garment is turned over",
            "It is crumpled: look at the labels and the pose of the first frame where it begins, and give these again."),
    Trouble("triangles go through one another", r"pairs of triangles go through",
            "A hand or a fold is caught between layers. The frame is usable where it looks right."),
    Trouble("the body's surface is torn", r"^body: (folded|stretch)",
            f"Folds and stretch that no cloth has; verdicts do not ask for them. Look at the first frame of the stretch; {AGAIN}."),
    Trouble("there is no scan", r"no scan shows where the surface lies",
            "Nothing shows where the surface lies: bring a scan, or enough cameras to make one."),
)  # fmt: skip
FAILURE = "Mend the file that is named, if one is, and give the failed frames again."
CONTACT = Trouble("hands touch the cloth", r"hands touch", "The method cannot represent it: leave these frames out, or mend them by hand.")  # fmt: skip
OUT = Trouble(
    "good, but odd: unlike the rest of the run", r"", "Look at the worst of them; if they look right, they are."
)


def trouble_of(reason: str) -> Trouble | None:
    """The kind that a verdict's reason belongs to."""
    return next((trouble for trouble in TROUBLES if re.search(trouble.pattern, reason)), None)


def title_of(reason: str) -> str:
    """A short name of the kind of a reason: the known kind's, else the reason with its numbers left out."""
    known = trouble_of(reason)
    return known.title if known else re.sub(r"\d+(\.\d+)?", "\u2026", reason)[:100]


def of_garment(reason: str) -> str:
    """The garment that a reason begins with, and its opening if it names one; "" without."""
    found = re.match(r"([\w.-]+): ", reason)
    return found.group(1).replace(".", " ") if found and trouble_of(reason) else ""


def advice_of(reasons: Sequence[str]) -> str:
    """What to do about the first of the reasons."""
    known = trouble_of(reasons[0]) if reasons else None
    return known.do if known else ""
