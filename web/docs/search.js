// Looks through every page's words in this tab; nothing is sent anywhere.
const script = document.currentScript
const index = new URL(script.dataset.index, location.href)
const box = document.getElementById('search')
const found = document.getElementById('found')
let pages = null

/** How well a page answers: every word must stand in it; its title counts more. */
function score(page, words) {
  const title = page.title.toLowerCase()
  const text = page.text.toLowerCase()
  let sum = 0
  for (const word of words) {
    const times = text.split(word).length - 1
    if (times === 0 && !title.includes(word)) return 0
    sum += Math.min(times, 20) + (title.includes(word) ? 50 : 0)
  }
  return sum
}

function excerpt(page, word) {
  const at = Math.max(page.text.toLowerCase().indexOf(word), 0)
  return page.text.slice(Math.max(at - 50, 0), at + 90)
}

function entry(page, word) {
  const item = document.createElement('li')
  const link = document.createElement('a')
  link.href = new URL(page.file, index)
  link.textContent = page.title
  const text = document.createElement('small')
  text.textContent = `… ${excerpt(page, word)} …`
  item.append(link, text)
  return item
}

async function look() {
  pages ??= await (await fetch(index)).json()
  const words = box.value.toLowerCase().split(/\s+/).filter(word => word.length > 1)
  const ranked = words.length ? pages.map(page => [score(page, words), page]).filter(([points]) => points > 0) : []
  ranked.sort((a, b) => b[0] - a[0])
  const items = ranked.slice(0, 12).map(([, page]) => entry(page, words[0]))
  if (words.length && !items.length) items.push(Object.assign(document.createElement('li'), { textContent: 'Nothing found.' }))
  found.replaceChildren(...items)
  found.hidden = items.length === 0
}

box.hidden = false
box.addEventListener('input', look)
