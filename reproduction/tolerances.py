"""Why the checks of each figure and table allow what they allow: a sentence a place, in the report beside the checks.

Three kinds of limits: what the source prints, or says in words that are then put as a number; a theorem's own bound, with room
for rounding or for the scatter of a count; and sizes that separate what is right from what the source shows to be wrong.
"""

TOLERANCES = {
    "Fig. 40": (
        "Two exact forms of one system differ by rounding alone; a wrong sign or order moves them by the size of the loop."
    ),
    "Fig. 83": "Two exact forms of one system differ by rounding alone.",
    "Fig. 39": (
        "The area of a quarter circle in its triangle, π/4; 6 % is over three standard deviations of the share among the "
        "some 700 of 2000 pairs that pass. That no pair passes the stricter test alone is a theorem."
    ),
    "Fig. 41": (
        "Whole numbers of a formula must be equal. Probabilities may lie beyond ζ by three standard deviations of their "
        "count, and only upwards where (2.24) is an upper bound."
    ),
    "Fig. 25–28": (
        "The theory's ratios hold of exact standard deviations; a ratio of two estimated from 50 to 150 repeats scatters "
        "by 8 to 14 %, and 25 % is twice to three times that. The bias of a consistent estimate must drown in one "
        "estimate's scatter."
    ),
    "Fig. 29–30": (
        "95 % within the scatter of counting so many repeats, and, for 200 samples, of the first order of (1.107)."
    ),
    "Fig. 31–32": "As Fig. 29–30; the least covered of twelve frequencies may lie lower than one chosen beforehand.",
    "Fig. 43": (
        "“Perfect” is put as 3 % at a resonance and a fit of 98 %, “almost perfect” as 10 % and 93 %; “cannot model the "
        "second resonance” as less than half of it."
    ),
    "Fig. 44": (
        "200 models are drawn, so that the truth lies within the farthest of them at nearly every frequency if the "
        "covariance is right: 95 %. The biased model's draws must miss it at half of the frequencies at least."
    ),
    "Fig. 45": "A bound is a bound: 1. Its share of exceptions is ε = 5 %. “Similar” is put as within a factor of two.",
    "Remark 2.9": "“Considerably larger” is put as three times, “lower” as lower at all; the bound as 1.",
    "Fig. 42": (
        "“Several” is put as two. A tenth of the settling time less must break the limit 1 + γ = 1.1. (2.36) is an "
        "identity; a settling time by 4/(ξω_n) is a rule of thumb and right to a factor of two."
    ),
    "Fig. 46": (
        "(2.39) is an identity. A search that starts from the optimum may gain 3 %, which is below what the grid resolves."
    ),
    "Fig. 47": "“Significantly better” is put as a fifth less.",
    "Fig. 48": "“Significantly better” is put as a fifth less; overshoots that are drawn as small as a tenth.",
    "Fig. 49": (
        "Curves that overlap may be 2 % of the step apart, as good ones 10 %; ô and ℓ̂ are limits. Definitions are exact "
        "to rounding."
    ),
    "Fig. 50": (
        "1 is the theorem's own limit. A tenth more of ω̂_c must break it, or the front is not the front; gains of a "
        "weight are exact."
    ),
    "Fig. 51": "ε = 5 % of the plants, so 3 of 60; the true plant is one, and must be inside.",
    "Fig. 52": "Inside is inside the range of the sampled plants; “out of scale” is put as twice beyond it.",
    "Fig. 53": "Inside is inside the range of the sampled plants; “out of scale” is put as twice beyond it.",
    "Fig. 54": "1 is the theorem's own limit; unstable plants must not be.",
    "Fig. 56": (
        "Curves that are drawn as one may differ by 20 % at the worst frequency below 10 rad/s, and by 10 % in static "
        "gain: the record has a variance ratio of 9. The bound is 1, its exceptions ε = 5 %; a weight that touches its "
        "dots is nearer than 0.8."
    ),
    "Fig. 57": (
        "“Mirrors” is put as a rank correlation below −0.9; the optimum of (4.8) is exact up to the order of Q̂, 5 %; β "
        "is a largest value on a grid, 2 %."
    ),
    "Fig. 58 (a)": "“At once” is one sample, 0.1 s.",
    "Fig. 58 (b)": (
        "“Detected” is put as one sample in a hundred, “cannot be detected” as none; the shift of a mean over 250 s "
        "scatters below 10 % of a step of 3."
    ),
    "(4.9)": (
        "No sample may pass; τ is a formula, 5 % for the estimate of ‖e‖∞. A threshold five times too high would be no threshold."
    ),
    "Fig. 55": (
        "“Highest” at nine frequencies of ten. Models that explain less than 85 % of another record's variance are no "
        "basis for a design."
    ),
    "Fig. 60": (
        "The number of samples is exact; no step at a seam may be larger than the ordinary ones. Drawn far apart: a fifth "
        "at least."
    ),
    "Fig. 61": (
        "A model of both lies between the two, their mean halfway to rounding; the bound's exceptions are ε = 5 %, and a "
        "weight that touches its dots is nearer than 0.8."
    ),
    "Fig. 62": "A tenth less of ℓ̂ must break the limit 1 + γ = 1.15; exceptions of the random plants are ε = 5 %.",
    "Fig. 63": "ô and ℓ̂ are limits; groups do not overlap if the least of one is above the largest of the other.",
    "Fig. 64": (
        "Six of 100 feasible pairs are printed: from a tenth of that share to three times. The red curve is the limit 1 + γ."
    ),
    "Fig. 65": (
        "“All” is all. Overshoots that are drawn as small are put as 15 %, and ℓ_max may be passed twice, being a bound "
        "of a weight."
    ),
    "Fig. 73": (
        "Visible in a plot is put as a fifth in the peak, more at all in kurtosis; two healthy tests may differ by a "
        "quarter. Definitions are exact but for the dropped ends of the record."
    ),
    "Fig. 74": (
        "A band is a cell of the tree, and found or not. Two ways to the kurtosis of one band differ by their filters' "
        "edges, which a fourth power doubles: 50 %. Nine random resonances of ten."
    ),
    "Fig. 75, Table 6": (
        "A kurtosis of 101 is made by few impacts and scatters by a quarter between tests of three minutes; RMS values "
        "that are printed alike may differ by a tenth, and two filters of one band by the same."
    ),
    "Fig. 76": "“High spikes” is half of the rounds, “very repeatable” one in twenty, as a 95 % limit has anyway.",
    "Fig. 77": (
        "“Mainly” and “then” are put as more at all; alike is a tenth. For other pliers the growth must stand out by 30 %."
    ),
    "Section 6.3": "A line is found if it lies within 2 % of the geometry's: slip of the rolling elements is 1 to 2 %.",
    "Fig. 78": "Cells and colours are read from the source, and equal or not.",
    "Fig. 84": (
        "Sums over the same lines are exact but for interpolation between them: 1 to 5 %; a window spreads a swing by a tenth. "
        "Four times above the band's edge a tone of 0.5 is damped 256 times; a twentieth is far from both that and from none."
    ),
    "Fig. 85": (
        "A motor's data sheet gives 1/K to a tenth, friction adds half of that: 15 %. The speed was 'about' 4100 rpm: 5 %."
    ),
    "Fig. 86": (
        "1.55 Hz is printed with three digits and follows from 'about' 4100 rpm: 5 %. Visible is put as half more than "
        "healthy, a general increase as a tenth."
    ),
    "Fig. 87": "“Well isolated” is put as four movements of five on their side of the boundary.",
    "Table 7": (
        "Our exemplars are simulated and the source's two are real: 2.5 points of all movements, ten of a row, the "
        "smallest of which has 37 movements, so that ten points are four of them."
    ),
    "Section 7.6": (
        "The source's number must lie in the 95 % interval of ours over exemplars; folds deviate by 5.7 points in the "
        "source, and 20 is over three times that. Labels drawn at random are told by half, and 65 % is three standard "
        "deviations beyond; who judges what he was taught tells all."
    ),
    "(A.7)": (
        "As Section 7.6. An honest validation may not be better than the mixed one; guessing healthy is beaten by half."
    ),
}
"""Place → why its checks allow what they allow."""
