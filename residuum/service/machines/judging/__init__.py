"""Windows judged by the diagnoser of their machine, and kept with the finding."""
