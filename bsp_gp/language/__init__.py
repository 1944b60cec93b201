"""What can be said: operators, grammars, derivations, formulas, typed laws."""
