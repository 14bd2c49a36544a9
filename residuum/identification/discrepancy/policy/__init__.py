"""Every number that the search for missing physics decides by, in one place, a file a question.

| file | question |
|---|---|
| `likelihood` | How far is a structure climbed, and which structures are too far behind? |
| `trials` | Which effects are tried, and from where? |
| `acceptance` | Does an effect join? |
| `answers` | What is said? |

Each number has its unit in brackets (none: a plain ratio or count), its meaning, and what set it: a calibration, a source, or
"chosen", which is said where nobody has measured what another value would change. Log-likelihoods are in nats [nat].
"""
