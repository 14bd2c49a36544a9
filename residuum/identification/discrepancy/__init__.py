"""Which physical effect does a model lack? One judge: free simulation, on blocks that the fit has not seen."""
