/*! cogsplat, Apache-2.0 */
var A=new Uint32Array(1),O=new Float32Array(A.buffer);function g(e){O[0]=e;let o=A[0]>>>16&32768,t=Math.min(Math.abs(e),65504);if(t<2**-14)return o|Math.round(t*2**24);O[0]=t;let s=A[0];return o|s+4095+(s>>>13&1)-939524096>>>13}function w(e){let o=e&32768?-1:1,t=e>>>10&31,s=e&1023;return o*(t===0?s*2**-24:(1024+s)*2**(t-25))}function S(e,o){let t=e*Math.exp(o);return t/(t+1-e)}var H=e=>({name:e,width:4,bytes:2}),m=(e,o=4)=>({name:e,width:o,bytes:4}),y=[H("dcColor"),m("transformA"),H("transformB")],D=[y,[...y,m("splatSH_1to3")],[...y,m("splatSH_1to3"),m("splatSH_4to7"),m("splatSH_8to11",1)],[...y,m("splatSH_1to3"),m("splatSH_4to7"),m("splatSH_8to11"),m("splatSH_12to15")]];var ct=Math.log(65504);function E({arrays:e,count:o},t,s,a){let[i,,c]=e,[n,,f]=s;for(let r=0;r<o;r++){let l=4*(a+r);n[l+3]=g(S(w(i[4*r+3]),t.opacities[r]));let p=Math.exp(t.scales[r]);for(let h=0;h<3;h++)f[l+h]=g(w(c[4*r+h])*p)}}var b=(...e)=>e.map(o=>({name:o,width:4,bytes:4})),B=[b("centers","shapes"),b("centers","shapes","sh1"),b("centers","shapes","sh1","sh2"),b("centers","shapes","sh1","sh2","sh3a","sh3b")];function F({arrays:e,count:o},t,s,a){let[i,c]=e,[n,f]=s;for(let r=0;r<o;r++){let l=4*(a+r),p=h=>g(w(h)+t.scales[r]);n[l+3]=g(S(w(i[4*r+3]),t.opacities[r])),f[l+1]=c[4*r+1]&65535|p(c[4*r+1]>>>16)<<16,f[l+2]=p(c[4*r+2]&65535)|p(c[4*r+2]>>>16)<<16}}var Y=new Float32Array(1),ut=new Uint32Array(Y.buffer);function k(e,o){return(e==="spark"?B:D)[o]}function U(e,o,t){return k(e,o).map(({width:s,bytes:a})=>a===4?new Uint32Array(s*t):new Uint16Array(s*t))}function G(e,o,t,s){let{arrays:a,count:i,layout:c}=e;a.forEach((n,f)=>t[f].set(n,n.length/i*s)),o!==void 0&&(c==="spark"?F:E)(e,o,t,s)}var Q={R:"L",L:"R",U:"D",D:"U",F:"B",B:"F"};function R(e,o="RUB"){return[...o].flatMap(t=>[...e].map(s=>s===t?1:s===Q[t]?-1:0))}function I(e,o="RUB"){let t=R(e,o);if(t[0]*(t[4]*t[8]-t[5]*t[7])-t[1]*(t[3]*t[8]-t[5]*t[6])+t[2]*(t[3]*t[7]-t[4]*t[6])<0)throw new RangeError(`axes ${e} are a reflection of ${o}`);let a=[1+t[0]-t[4]-t[8],1-t[0]+t[4]-t[8],1-t[0]-t[4]+t[8],1+t[0]+t[4]+t[8]],i=a.indexOf(Math.max(...a)),c=Math.sqrt(a[i]),n=.5/c;switch(i){case 0:return[c/2,(t[1]+t[3])*n,(t[2]+t[6])*n,(t[7]-t[5])*n];case 1:return[(t[1]+t[3])*n,c/2,(t[5]+t[7])*n,(t[2]-t[6])*n];case 2:return[(t[2]+t[6])*n,(t[5]+t[7])*n,c/2,(t[3]-t[1])*n];default:return[(t[7]-t[5])*n,(t[2]-t[6])*n,(t[3]-t[1])*n,c/2]}}function z(e,o){let t=e;for(let[s,a]of o){if(!t.includes(s))return;t=t.replaceAll(s,a)}return t}function N(e){return Number.isInteger(e)?`${e}.0`:String(e)}var Z=250,tt=6;function P(e,o){return Math.min(o.degree??e.info.shDegree,e.info.shDegree)}async function V(e,o,t,s,a){let i=s.compensate??!0,c=new C(e,t,i),n=new T,f=-1/0,r=e.stream({...s,degree:P(e,s),compensate:i,format:o,signal:a});for await(let l of r)c.put(l.chunk,{texels:l.texels,firstRow:l.firstRow},l.prefix),await n.rest(),!(performance.now()-f<(s.uploadInterval??Z))&&(await c.show(n),s.onUpload?.(c.shown),f=performance.now());await c.show(n),s.onUpload?.(c.shown)}function W(e,o,t){return U(o,t,e.info.splats)}var C=class{scene;target;compensate;shown=0;rows=0;prefix=0;chunks=new Map;fresh=new Set;shownPrefix=-1;constructor(o,t,s){this.scene=o,this.target=t,this.compensate=s}put(o,t,s){this.chunks.set(o,t),this.fresh.add(o),this.rows=Math.max(this.rows,t.firstRow+t.texels.count),this.prefix=s}async show(o){let t=this.prefix,s=this.compensate&&t!==this.shownPrefix?[...this.chunks.keys()]:[...this.fresh];if(s.length!==0){for(let a of s){let{texels:i,firstRow:c}=this.chunks.get(a),n=this.compensate&&a<t?this.scene.compensation.shifts(t,a):void 0;G(i,n,this.target.arrays,c),await o.rest()}this.fresh.clear(),this.shownPrefix=t,this.shown=this.rows,(!this.compensate||t===this.scene.index.totalChunkCount)&&this.chunks.clear(),this.target.upload(this.rows)}}},T=class{since=performance.now();async rest(){performance.now()-this.since<tt||(await new Promise(o=>setTimeout(o,0)),this.since=performance.now())}};function q(e){let o=new AbortController;return e?.aborted?o.abort(e.reason):e?.addEventListener("abort",()=>o.abort(e.reason),{once:!0}),o}function J(e,{worldOrigin:o}){let t=e.info.origin.map((a,i)=>a-(o??e.info.origin)[i]),s=R(e.info.axes);return[0,1,2].map(a=>t.reduce((i,c,n)=>i+s[3*a+n]*c,0))}function Ct(e,o,{info:t}){let{gsplat:s}=o.scene;s.minPixelSize=0,s.antiAlias=t.antialiased;let a=e.ShaderChunks.get(o.graphicsDevice,"glsl"),i=N(4*t.kernelPx),c={gsplatPS:[["normExp(A) * gaussianColor.a","min(0.99, exp(A * -4.0) * gaussianColor.a)"],["if (A > 1.0)","if (A > 1.4)"]],gsplatCommonVS:[["float clip = min(1.0, sqrt(max(0.0, log(alpha / alphaClipValue))) * 0.5);","float clip = sqrt(max(0.0, log(alpha / alphaClipValue))) * 0.5;"]],gsplatCornerVS:[["+ 0.3",`+ ${i}`],["vec2 J2 = -J1 / vp.z * vp.xy;","vec2 edge = 1.3 / vec2(center.projMat00, abs(center.projMat11)); vec2 J2 = -J1 * clamp(vp.xy / vp.z, -edge, edge);"],["min(1024.0, min(viewport_size.x, viewport_size.y))","1e6"]]},n=Object.entries(c).map(([f,r])=>[f,z(a.get(f)??"",r)]);if(n.some(([,f])=>f===void 0))return!1;for(let[f,r]of n)s.material.getShaderChunks("glsl").set(f,r);return!0}var et=`
uint cogsRotation;
vec4 cogsScale;
vec3 getCenter() {
  uvec4 transform = loadTransformA();
  cogsRotation = transform.w;
  cogsScale = loadTransformB();
  return uintBitsToFloat(transform.xyz);
}
vec4 getColor() { return loadDcColor(); }
vec3 getScale() { return cogsScale.xyz; }
vec4 getRotation() {
  vec3 s = (vec3((uvec3(cogsRotation) >> uvec3(0u, 10u, 20u)) & 1023u) / 511.5 - 1.0) * 0.70710678;
  float rest = sqrt(max(0.0, 1.0 - dot(s, s)));
  uint largest = cogsRotation >> 30u;
  if (largest == 0u) return vec4(rest, s);
  if (largest == 1u) return vec4(s.x, rest, s.yz);
  return largest == 2u ? vec4(s.xy, rest, s.z) : vec4(s, rest);
}
#include "gsplatUncompressedSHVS"
`,ot=`
var<private> cogsRotation: u32;
var<private> cogsScale: vec4f;
fn getCenter() -> vec3f {
  let transform: vec4<u32> = loadTransformA();
  cogsRotation = transform.w;
  cogsScale = loadTransformB();
  return bitcast<vec3f>(transform.xyz);
}
fn getColor() -> vec4f { return loadDcColor(); }
fn getScale() -> vec3f { return cogsScale.xyz; }
fn getRotation() -> vec4f {
  let s = (vec3f((vec3u(cogsRotation) >> vec3u(0u, 10u, 20u)) & vec3u(1023u)) / 511.5 - 1.0) * 0.70710678;
  let rest = sqrt(max(0.0, 1.0 - dot(s, s)));
  let largest = cogsRotation >> 30u;
  if (largest == 0u) { return vec4f(rest, s); }
  if (largest == 1u) { return vec4f(s.x, rest, s.yz); }
  if (largest == 2u) { return vec4f(s.xy, rest, s.z); }
  return vec4f(s, rest);
}
#include "gsplatUncompressedSHVS"
`;function Tt(e,o,t,s={}){let a=P(e,s),i=k("playcanvas",a),c=W(e,"playcanvas",a),n=i.map(({name:u,width:M,bytes:x})=>({name:u,format:x===2?o.PIXELFORMAT_RGBA16F:M===1?o.PIXELFORMAT_R32U:o.PIXELFORMAT_RGBA32U})),f=new o.GSplatFormat(t,n,{readGLSL:et,readWGSL:ot}),r=new o.GSplatContainer(t,Math.max(1,e.info.splats),f);r.configureMaterialDefines=u=>u.set("SH_BANDS",String(a)),r.gsplatData.shBands=a;let{box:l}=e.info,[p,h]=[[0,1,2].map(u=>(l[u]+l[u+3])/2),[0,1,2].map(u=>(l[u+3]-l[u])/2)];r.aabb.center.set(p[0],p[1],p[2]),r.aabb.halfExtents.set(h[0],h[1],h[2]),r.update(0);let v=c[1],$=new Float32Array(v.buffer,v.byteOffset,v.length),j=u=>{i.forEach(({name:x},d)=>{let L=r.getTexture(x);L.lock().set(c[d]),L.unlock()});let{centers:M}=r;for(let x=0;x<u;x++)for(let d=0;d<3;d++)M[3*x+d]=$[4*x+d];r.update(u,!0)},_=q(s.signal),K=V(e,"playcanvas",{arrays:c,upload:j},s,_.signal);return{resource:r,rotation:I(e.info.axes),position:J(e,s),done:K,dispose(){_.abort(),r.destroy()}}}export{Ct as drawBySpec,Tt as streamToPlayCanvas};
