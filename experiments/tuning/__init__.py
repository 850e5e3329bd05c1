"""How the settings of the groundings were chosen, and what each change of `Vine` brings."""
