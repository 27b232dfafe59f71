"""Classes of networks that label people, by the number that each class has. Left and right are the person's own.

Sources: the ATR and LIP data sets as SCHP (Li et al. 2020) and SegFormer-clothes list them, Sapiens' Goliath classes.
"""

TABLES: dict[str, tuple[str, ...]] = {
    "atr18": (
        "Background", "Hat", "Hair", "Sunglasses", "Upper-clothes", "Skirt", "Pants", "Dress", "Belt", "Left-shoe",
        "Right-shoe", "Face", "Left-leg", "Right-leg", "Left-arm", "Right-arm", "Bag", "Scarf",
    ),
    "lip20": (
        "Background", "Hat", "Hair", "Glove", "Sunglasses", "Upper-clothes", "Dress", "Coat", "Socks", "Pants", "Jumpsuits",
        "Scarf", "Skirt", "Face", "Left-arm", "Right-arm", "Left-leg", "Right-leg", "Left-shoe", "Right-shoe",
    ),
    "sapiens28": (
        "Background", "Apparel", "Face_Neck", "Hair", "L_Foot", "L_Hand", "L_Lower_Arm", "L_Lower_Leg", "L_Shoe", "L_Sock",
        "L_Upper_Arm", "L_Upper_Leg", "Lower_Clothing", "R_Foot", "R_Hand", "R_Lower_Arm", "R_Lower_Leg", "R_Shoe", "R_Sock",
        "R_Upper_Arm", "R_Upper_Leg", "Torso", "Upper_Clothing", "Lower_Lip", "Upper_Lip", "Lower_Teeth", "Upper_Teeth",
        "Tongue",
    ),
}  # fmt: skip
