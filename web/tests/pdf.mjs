/** What a PDF holds, sheet by sheet: its text as it can be copied, the colours its lines are drawn in, its size in points. */
import { getDocumentProxy, getResolvedPDFJS } from 'unpdf'

export async function pagesOf(bytes) {
  const { OPS } = await getResolvedPDFJS()
  const file = await getDocumentProxy(new Uint8Array(bytes), { stopAtErrors: true })
  const sheet = async (_, index) => {
    const page = await file.getPage(index + 1)
    const [left, bottom, right, top] = page.view
    const { items } = await page.getTextContent()
    const { fnArray, argsArray } = await page.getOperatorList()
    const lines = fnArray.flatMap((operator, k) => (operator === OPS.setStrokeRGBColor ? [argsArray[k][0]] : []))
    return { text: items.map((item) => item.str).join(' '), lines, width: right - left, height: top - bottom }
  }
  return Promise.all(Array.from({ length: file.numPages }, sheet))
}
