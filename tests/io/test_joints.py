"""Roles of joints by the names that common skeletons give them."""

import pytest

from toile.io.joints import joint_roles

SMPL = {
    "Pelvis": "root", "L_Hip": "upperleg01.L", "R_Knee": "lowerleg01.R", "L_Ankle": "foot.L", "R_Foot": "toe1-1.R",
    "Spine1": "spine02", "Spine2": "spine", "Spine3": "spine", "Neck": "neck01", "Head": "head", "L_Collar": "clavicle.L",
    "R_Shoulder": "upperarm01.R", "L_Elbow": "lowerarm01.L", "R_Wrist": "wrist.R", "L_Hand": "finger.L",
    "left_index1": "finger.L", "right_thumb3": "finger.R", "jaw": "jaw", "left_eye_smplhf": "eye.L",
}  # fmt: skip
CMU = {
    "Hips": "root", "LHipJoint": "LHipJoint", "LeftUpLeg": "upperleg01.L", "RightLeg": "lowerleg01.R", "LeftFoot": "foot.L",
    "RightToeBase": "toe1-1.R", "LowerBack": "LowerBack", "Spine": "spine04", "Spine1": "spine02", "Neck": "neck",
    "Neck1": "neck01", "Head": "head", "LeftShoulder": "clavicle.L", "RightArm": "upperarm01.R",
    "LeftForeArm": "lowerarm01.L", "RightHand": "wrist.R", "LeftFingerBase": "finger.L", "RThumb": "finger.R",
}  # fmt: skip
POSER = {
    "hip": "root", "abdomen": "spine04", "chest": "spine02", "lCollar": "clavicle.L", "rShldr": "upperarm01.R",
    "lForeArm": "lowerarm01.L", "rHand": "wrist.R", "lThigh": "upperleg01.L", "rShin": "lowerleg01.R",
}  # fmt: skip
ENGINE = {
    "pelvis": "root", "spine_01": "spine04", "spine_02": "spine02", "neck_01": "neck01", "clavicle_l": "clavicle.L",
    "upperarm_r": "upperarm01.R", "lowerarm_l": "lowerarm01.L", "hand_r": "wrist.R", "thumb_01_l": "finger.L",
    "thigh_r": "upperleg01.R", "calf_l": "lowerleg01.L", "foot_r": "foot.R", "ball_l": "toe1-1.L",
}  # fmt: skip
MIXAMO = {
    f"mixamorig:{name}": role for name, role in CMU.items() if name in ("Hips", "LeftUpLeg", "RightArm", "Spine1")
}
GROUNDED = {"root": "ground"} | ENGINE
SHINS = {
    "Hips": "root", "LeftLeg": "upperleg01.L", "LeftShin": "lowerleg01.L", "LeftFoot": "foot.L", "RightLeg": "upperleg01.R",
    "RightShin": "lowerleg01.R", "Chest": "spine02", "LeftArm": "upperarm01.L", "LeftToes": "toe1-1.L",
}  # fmt: skip
TWISTED = {
    "Hips": "root", "LeftUpLeg": "upperleg01.L", "LeftLeg": "lowerleg01.L", "LeftCalf": "LeftCalf", "LeftFoot": "foot.L",
    "RightLeg": "upperleg01.R", "RightCalf": "lowerleg01.R", "RightFoot": "foot.R",
}  # fmt: skip
CALVES = {
    "Hips": "root", "LeftThigh": "upperleg01.L", "LeftLeg": "lowerleg01.L", "LeftCalf": "LeftCalf", "LeftFoot": "foot.L",
    "RightLeg": "RightLeg", "RightThigh": "upperleg01.R", "RightCalf": "lowerleg01.R", "RightFoot": "foot.R",
}  # fmt: skip
NUMBERED = {f"Character1_{name}": role for name, role in CMU.items() if role != name}
BIPED = {
    "Bip01": "Bip01", "Bip01 Pelvis": "root", "Bip01 Spine": "spine04", "Bip01 L Thigh": "upperleg01.L",
    "Bip01 R Calf": "lowerleg01.R", "Bip01 L UpperArm": "upperarm01.L", "Bip01 R Forearm": "lowerarm01.R", "Bip01 Head": "head",
}  # fmt: skip
COMMON = {
    "smpl": SMPL, "cmu": CMU, "poser": POSER, "engine": ENGINE, "mixamo": MIXAMO, "engine with a root": GROUNDED,
    "thighs called legs": SHINS, "shanks called legs beside calves": TWISTED, "shanks called legs below thighs": CALVES, "motionbuilder": NUMBERED, "biped": BIPED,
}  # fmt: skip


@pytest.mark.parametrize("names", COMMON.values(), ids=COMMON)
def test_names_of_common_skeletons(names):
    assert dict(zip(names, joint_roles(tuple(names)))) == names


def test_the_packaged_model_s_names_are_the_roles():
    from toile.io.body import load_body_model

    model = load_body_model()
    assert joint_roles(model.joint_names) == model.joint_names == model.joint_roles


def test_a_role_goes_to_one_joint_and_unknown_names_stay():
    assert joint_roles(("hips", "pelvis", "tail", "Ⅲ")) == ("root", "pelvis", "tail", "Ⅲ")


def test_what_several_names_begin_with_is_theirs_where_hips_are_found():
    names = ("Hips", "upper_arm.L", "upper_arm.R")
    assert joint_roles(names) == ("root", "upperarm01.L", "upperarm01.R")
    assert joint_roles(("Character1_Hips", "Character1_Tail", "Character1_Head")) == ("root", "Character1_Tail", "head")
    assert joint_roles(("stem", "L_arm", "L_hand")) == ("stem", "upperarm01.L", "wrist.L")
