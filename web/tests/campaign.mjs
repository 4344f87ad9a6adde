/** A laboratory whose powders pile steeper in humid air. */

/** Sugar and salt get steeper in humid air, sand does not: 8 days of 3 powders and 3 repeats. */
export function humidDays() {
  let seed = 1
  // A linear congruential generator, so that the file is the same every time; the sum of four is nearly normal.
  const uniform = () => (seed = (seed * 48271) % 2147483647) / 2147483647
  const noise = () => (uniform() + uniform() + uniform() + uniform() - 2) * 1.7
  const lines = ['powder,repose_deg,session,relative_humidity_pct,temperature_c,operator']
  for (let day = 1; day <= 8; day++) {
    const humidity = 28 + 45 * uniform()
    const shift = 0.3 * noise()
    for (const [powder, mean, effect] of [['sand', 28.6, 0], ['sugar', 31.4, 4], ['salt', 36.4, 4]]) {
      for (let repeat = 0; repeat < 3; repeat++) {
        const angle = mean + (effect * (humidity - 50)) / 30 + shift + 0.5 * noise()
        lines.push([powder, angle.toFixed(2), `day${day}`, humidity.toFixed(1), (21 + noise()).toFixed(1), day % 2 ? 'A' : 'B'].join(','))
      }
    }
  }
  return `${lines.join('\n')}\n`
}
