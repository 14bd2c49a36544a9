"""Missing physics judged by free simulation on blocks of the records that the fit has not seen."""
