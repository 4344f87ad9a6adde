/** What web/texts.js makes of the texts of a language. */
type Filled = (values?: Record<string, string | number>) => string
declare module 'texts:en' {
  const texts: Record<string, string | Filled>
  export default texts
}
declare module 'texts:de' {
  const texts: Record<string, string | Filled>
  export default texts
}
declare module 'texts:ja' {
  const texts: Record<string, string | Filled>
  export default texts
}
