"""The paper's results, to stand beside ours (IJCAI 2022, tables 1 and 2): mean return in the target over five seeds."""

TASKS = ("SkewedPendulum", "BrokenHopper", "BrokenCheetah", "HeavyCheetah")
SAMPLES = (500, 1_000, 5_000, 10_000, 50_000, 100_000)

DIRECT = dict(zip(TASKS, (33.9, 164.5, 1611.7, 3396.2), strict=True))
TARGET = dict(zip(TASKS, (1000.0, 862.2, 6470.2, 5226.9), strict=True))

METHODS = ("SPG", "MPG-ER", "MPGE-ER", "MPG-MS", "MPGE-MS")
_RETURNS = {
    "SkewedPendulum": (
        (630, 738, 1000, 682, 990),
        (293, 548, 1000, 636, 994),
        (808, 804, 973, 971, 1000),
        (516, 791, 996, 968, 991),
        (788, 971, 812, 994, 971),
        (606, 964, 982, 995, 984),
    ),
    "BrokenHopper": (
        (223, 455, 410, 445, 568),
        (197, 400, 621, 528, 645),
        (355, 450, 677, 551, 624),
        (341, 417, 670, 479, 578),
        (268, 512, 682, 497, 609),
        (374, 398, 482, 390, 624),
    ),
    "BrokenCheetah": (
        (3457, 2437, 4765, 2783, 4653),
        (3849, 3780, 4820, 4336, 5296),
        (4474, 5369, 6070, 5284, 5870),
        (4379, 4937, 5777, 5866, 5570),
        (4840, 5258, 6035, 5794, 5801),
        (5117, 5763, 6302, 5650, 5920),
    ),
    "HeavyCheetah": (
        (2643, 2994, 5246, 3622, 5304),
        (3116, 4438, 6636, 3625, 5179),
        (4970, 4373, 6394, 4773, 5805),
        (4796, 5239, 7083, 4711, 6094),
        (4986, 5549, 5879, 5584, 5840),
        (4965, 5797, 6270, 5044, 5504),
    ),
}


def mean_return(task: str, method: str, samples: int) -> float | None:
    """The paper's figure for a cell, or None where it has none."""
    if method == "direct":
        return DIRECT.get(task)
    if method == "target":
        return TARGET.get(task)
    if task not in _RETURNS or method not in METHODS or samples not in SAMPLES:
        return None
    return float(_RETURNS[task][SAMPLES.index(samples)][METHODS.index(method)])
