"""Which rules of the diagnosis decide anything: each is switched off by itself, and answers are compared.

`rules` lists them, `gates` has what stands in their place, `replaced` switches them off or watches them, `one`
diagnoses a case so, `compared` and `table` compare.
"""
