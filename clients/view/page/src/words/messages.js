// UI strings for one language, falling back to English where a translation is missing.

/** Returns the first of the `wanted` languages (such as "de-AT") for which `available` has a file (such as "de"), or "en" if there is none. */
export function chooseLanguage(wanted, available) {
  for (const language of wanted) {
    const found = [language.toLowerCase(), language.toLowerCase().split('-')[0]].find((code) => available.includes(code))
    if (found) return found
  }
  return 'en'
}

export class Messages {
  /** `own` and `english` map keys to texts. A text is a string with placeholders such as {count}. If it depends on the number `count`, it is an object
   * with a string for each plural category of the language (Unicode CLDR: one, few, many, other, ...). */
  constructor(language, own, english) {
    Object.assign(this, { language, own, english })
    this.plural = new Intl.PluralRules(language)
    this.englishPlural = new Intl.PluralRules('en')
  }

  has(key) { return key in this.own || key in this.english }

  /** Translates a message from trocar-view or the server if it matches the English form of one of the texts said.*; otherwise returns it unchanged. A
   * message may contain another one, such as the reason for a refusal. The first matching text is used. */
  said(message) {
    for (const [key, english] of Object.entries(this.english)) {
      if (!key.startsWith('said.')) continue
      const pattern = english.replace(/[.*+?^$()|[\]\\]/g, '\\$&').replace(/\{(\w+)\}/g, '(?<$1>.+?)'), found = new RegExp(`^${pattern}$`).exec(message)
      if (found) return this.text(key, Object.fromEntries(Object.entries(found.groups ?? {}).map(([name, part]) => [name, this.said(part)])))
    }
    return message
  }

  /** Returns the text with this key, with {name} replaced with `values.name`. If neither language has the text, returns the key. */
  text(key, values = {}) {
    const mine = key in this.own, found = mine ? this.own[key] : this.english[key] ?? key
    const plural = mine ? this.plural : this.englishPlural
    const text = typeof found === 'string' ? found : found[plural.select(values.count ?? 0)] ?? found.other
    return text.replace(/\{(\w+)\}/g, (place, name) => (name in values ? values[name] : place))
  }
}
