// What an indicator is, in a sentence, for whoever rests on its name.

const MEANING = {
  glr: "How much better an offset, a gain or a changed power explains the last samples of the residual than none does.",
  F1: "Sum of the residual envelope's amplitudes at multiples of the shaft's fault frequency.",
  F2: "Sum of the residual envelope's amplitudes within 5 % around multiples of the shaft's fault frequency.",
  band_excess: "The largest of the frequency bands' vibrations over its healthy limit.",
  notch_match: "How much of a typical turn of the shaft looks like a notch in one tooth.",
  single_pulse: "Largest knock at one place of the way, in standard deviations.",
  periodic_pulse: "Largest knock of a typical turn of the shaft, in standard deviations.",
  level: "Size of the residual over the whole window.",
  deviation: "Distance of the window from healthy ones, in standard deviations.",
  robust_peak: "Largest value of the post-filtered residual.",
  severity: "The largest indicator over its limit.",
};

const FAMILY = [
  [/^prominence_/, "How far the fault's lines stand above control frequencies in the spectrum of the envelope."],
  [/^kurtosis/, "How spiky the vibration is: 3 for noise, more for knocks."],
  [/^crest|_crest$/, "Largest value over the RMS: how high single knocks stand out."],
  [/^impulsiveness/, "Largest value over the mean magnitude: how high single knocks stand out."],
  [/^rms|_rms$/, "Root of the mean square: the usual size."],
  [/_peak$/, "Largest value in this band."],
];

export const meaning = (name) => MEANING[name] ?? FAMILY.find(([shape]) => shape.test(name))?.[1] ?? name;
