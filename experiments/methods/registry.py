"""The methods of the comparison, by name."""

from collections.abc import Sequence

from experiments.methods.baselines import direct, finetune, target
from experiments.methods.cell import Method
from experiments.methods.corrected_reward import corrected_reward
from experiments.methods.diagnosed import diagnosed, diagnosed_and_grounded
from experiments.methods.grounded import grounded
from experiments.methods.randomised import randomised
from experiments.methods.residual import delta

METHODS = {
    method.name: method
    for method in (
        Method("direct", "the source policy, as it is", direct),
        Method(
            "SPG",
            "one rollout policy, one transformer (GARAT)",
            grounded,
            samples="log",
            grounding="adversarial",
            several_policies=False,
        ),
        Method("MPG-MS", "several seeds, one transformer", grounded, samples="log", grounding="adversarial"),
        Method(
            "MPG-ER",
            "entropy-regularised policies, one transformer",
            grounded,
            kind="ER",
            samples="log",
            grounding="adversarial",
        ),
        Method(
            "MPGE-MS",
            "several seeds, an ensemble",
            grounded,
            samples="log",
            grounding="adversarial",
            ensemble=True,
        ),
        Method(
            "MPGE-ER",
            "entropy-regularised policies, an ensemble",
            grounded,
            kind="ER",
            samples="log",
            grounding="adversarial",
            ensemble=True,
        ),
        Method(
            "Vine",
            "this project's: an ensemble, from several draws at every state and a discriminator of residuals",
            grounded,
            samples="log",
            grounding="vine",
            ensemble=True,
        ),
        Method(
            "GAT",
            "the simulator inverted on the target's transitions, then regressed",
            grounded,
            samples="log",
            grounding="inversion",
        ),
        Method(
            "MPGE+",
            "this project's: an ensemble from the inversion, then Vine's grounding from logged states",
            grounded,
            samples="log",
            grounding="inversion+vine",
            ensemble=True,
        ),
        Method(
            "diagnosed",
            "this project's: the simulator corrected by what the diagnosis names",
            diagnosed,
            samples="log",
        ),
        Method(
            "diagnosed+MPGE",
            "this project's: the corrected simulator, grounded as MPGE-MS",
            diagnosed_and_grounded,
            samples="log",
            grounding="adversarial",
            ensemble=True,
        ),
        Method(
            "delta",
            "a residual policy that makes the simulator follow the log (ASAP), then agents behind it",
            delta,
            samples="log",
        ),
        Method(
            "DARC",
            "agents in the simulator, whose reward is corrected by classifiers of source and target",
            corrected_reward,
            samples="log",
        ),
        Method("DR", "domain randomisation: agents in machines drawn around the simulator", randomised),
        Method(
            "finetune", "SAC goes on in the target for the metered number of steps", finetune, samples="agent"
        ),
        Method("target", "trained on in the target itself, within the preset's budget", target),
    )
}


def from_logs() -> list[str]:
    """Methods that learn from a log, and so need no target to act in."""
    return [name for name, method in METHODS.items() if method.samples == "log"]


def known_samples(samples: Sequence[int], method: str) -> list[int]:
    """The sample sizes that a method has cells for: 0 alone where it uses none."""
    return list(samples) if METHODS[method].uses_samples else [0]
