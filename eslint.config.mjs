// Rules for JavaScript: `make lint`. Types are the TypeScript compiler's business (tsconfig.json).
import js from '@eslint/js';
import globals from 'globals';

const MOST_LINES = 60; // of a function; blank lines and comments count

/** Limits the code of a module that runs while it loads, which no limit for functions covers. */
const shortModuleCode = {
  meta: {
    type: 'suggestion',
    schema: [{ type: 'integer' }],
    messages: {
      long: 'This module runs {{lines}} lines of code while it loads. At most {{most}} are allowed: write functions.',
    },
  },
  create(context) {
    const declares = /^(Import|Export|Function|Class)/;
    const isConstant = (statement) => statement.type === 'VariableDeclaration' && statement.kind === 'const';
    return {
      Program({ body }) {
        const [most] = context.options;
        const running = body.filter((statement) => !declares.test(statement.type) && !isConstant(statement));
        const lines = running.reduce((sum, { loc }) => sum + loc.end.line - loc.start.line + 1, 0);
        if (lines > most) context.report({ loc: running[0].loc, messageId: 'long', data: { lines, most } });
      },
    };
  },
};

/** Refuses comments that switch the TypeScript compiler off, and the type `any`, which does the same for a value. */
const noUncheckedTypes = {
  meta: {
    type: 'problem',
    schema: [],
    messages: { unchecked: 'The TypeScript compiler checks nothing here: write the type, or `unknown` and a check.' },
  },
  create({ sourceCode, report }) {
    const switchesOff = ({ value }) =>
      /@ts-(ignore|nocheck|expect-error)/.test(value) || /\{[^}]*\bany\b[^}]*\}/.test(value);
    return {
      Program() {
        for (const { loc } of sourceCode.getAllComments().filter(switchesOff)) report({ loc, messageId: 'unchecked' });
      },
    };
  },
};

const workers = ['services/web/**/*-worker.js'];
const onPages = ['services/web/shared/register-service-worker.js'];

export default [
  { ignores: ['services/web/vendor/', 'node_modules/', '.venv/', 'clients/', 'build/', 'dist/', 'demo/', 'out/'] },
  js.configs.recommended,
  {
    linterOptions: { reportUnusedDisableDirectives: 'error' },
    plugins: {
      capture2vr: { rules: { 'no-unchecked-types': noUncheckedTypes, 'short-module-code': shortModuleCode } },
    },
    rules: {
      'capture2vr/no-unchecked-types': 'error',
      'capture2vr/short-module-code': ['error', MOST_LINES],
      'max-lines-per-function': ['error', MOST_LINES],
      complexity: ['error', 15],
      curly: ['error', 'multi-line'],
      eqeqeq: 'error',
      'no-eval': 'error',
      'no-implicit-globals': 'error',
      'no-implied-eval': 'error',
      'no-shadow': 'error',
      'no-throw-literal': 'error',
      'no-var': 'error',
      'object-shorthand': 'error',
      'prefer-const': 'error',
      'prefer-promise-reject-errors': 'error',
    },
  },
  { files: ['services/web/**/*.js'], ignores: workers, languageOptions: { globals: globals.browser } },
  { files: onPages, languageOptions: { globals: globals.browser } },
  { files: workers, ignores: onPages, languageOptions: { globals: { ...globals.worker, ...globals.serviceworker } } },
  {
    files: ['services/web/graphics/ktx2-worker.js'], // no module, because importScripts is for scripts alone
    languageOptions: { sourceType: 'script', globals: { BASIS: 'readonly' } },
    rules: { 'no-implicit-globals': 'off' },
  },
  { files: ['**/*.mjs'], languageOptions: { globals: globals.node } },
];
