"""Rollout policies: what drives the target while it is recorded, and the simulator while it is grounded.

Any pure function of parameters, observation and key will do:

>>> def act(params, obs, key):
...     return params @ obs + 0.1 * jax.random.normal(key, (1,))
>>> policies = RolloutPolicies(act=act, params=jnp.zeros((3, 1, 4)))  # three linear policies

Shapes: `K` policies, `O` observation, `A` action size.
"""

from collections.abc import Callable
from typing import Any

import flax.struct
import jax
from jaxtyping import Array, Float, PRNGKeyArray

from envs import Environment

Params = Any
Act = Callable[[Params, Float[Array, " O"], PRNGKeyArray], Float[Array, " A"]]


class RolloutPolicies(flax.struct.PyTreeNode):
    """K policies of one form.

    Attributes:
      params: every leaf `[K, ...]`.
      act: `(params of one policy, obs [O], key) -> action [A]`, pure; the key is consumed. Static: a function that is
        defined once, for every new one is compiled anew.
    """

    params: Params
    act: Act = flax.struct.field(pytree_node=False)

    @property
    def size(self) -> int:
        """K."""
        return int(jax.tree.leaves(self.params)[0].shape[0])

    def check_fits(self, env: Environment) -> None:
        """Makes sure that these policies act in `env`.

        Raises:
          ValueError: they do not: parameters of different numbers of policies, or an action of another shape.
        """
        sizes = {leaf.shape[0] if leaf.ndim else None for leaf in jax.tree.leaves(self.params)}
        if len(sizes) != 1 or None in sizes:
            raise ValueError("every parameter of the rollout policies needs a first axis of one length, K")
        one = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), self.params)
        obs = jax.ShapeDtypeStruct((env.observation_size,), "float32")
        try:
            found = jax.eval_shape(self.act, one, obs, jax.random.key(0))
        # Whatever the function raises on an observation of another size.
        except Exception as error:
            reason = str(error).strip().partition("\n")[0]
            raise ValueError(
                f"these rollout policies cannot act on the {env.observation_size} observations of {env.name} "
                f"({type(error).__name__}: {reason})"
            ) from error
        shape = getattr(found, "shape", None)
        if shape != (env.action_size,):
            what = f"a {type(found).__name__}" if shape is None else f"actions of shape {shape}"
            raise ValueError(
                f"these rollout policies give {what}, {env.name} wants an array of shape ({env.action_size},); each "
                f"acts by its own row of the parameters, whose first axis counts the policies (here {self.size})"
            )
