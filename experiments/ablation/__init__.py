"""Which rules of the diagnosis decide anything: each is switched off by itself, and answers are compared.

`gates` lists the rules, `replaced` switches them off or watches them, `one` diagnoses a case so, `table` compares.
"""
